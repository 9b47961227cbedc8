// Drapes poses without a service, frame by frame, beside the library's modules in a folder of python -m service.static.
import { makeTargets } from "./decode.js";
import { filesOf } from "./files.js";
import { compiled } from "./folds.js";
import { LocalDecoder } from "./local_decoder.js";
import { topologyOf } from "./topology.js";
import { packPose } from "./wire.js";

const base = new URL("./", import.meta.url).href;
const file = filesOf(base);
const json = async (name) => JSON.parse(new TextDecoder().decode(await file(name)));
async function measured() {
  const [about, asked] = await Promise.all([json("about.json"), json("asked.json")]);
  const garment = `/garments/${about.garment}`;
  const [layout, constants, mesh] = await Promise.all([
    file(about.answers[`${garment}/jets`]), file(about.answers[`${garment}/folds`]), json(about.answers[`${garment}/mesh`]),
  ]);
  const layers = [{ ...topologyOf(mesh), layout }];
  const begun = performance.now();
  const decoder = await LocalDecoder.make({ folder: { base, about, file }, provider: asked.provider }, layers, { module: await compiled(), constants });
  const startMs = performance.now() - begun;
  const { network } = decoder;
  let networkMs = 0;
  const frame = network.frame.bind(network);
  network.frame = async (...pose) => {
    const from = performance.now();
    const found = await frame(...pose);
    networkMs = performance.now() - from;
    return found;
  };
  const targets = makeTargets(layers);
  const count = 3 * layers[0].vertexCount;
  const found = new Float32Array(asked.poses.length * count);
  const took = [];
  for (const [number, pose] of asked.poses.entries()) {
    const message = packPose({ sequence: number, clientTimeS: number / asked.fps, trans: asked.trans[number], pose });
    const from = performance.now();
    await decoder.decode(message, targets, { effort: { ...about.opened, ...asked.effort } });
    took.push([performance.now() - from, networkMs]);
    found.set(targets[0].positions.subarray(0, count), number * count);
  }
  await fetch("vertices.bin", { method: "POST", body: found });
  return { start_ms: startMs, took, told: network.told };
}
const said = await measured().catch((error) => ({ error: error.stack }));
await fetch("said.json", { method: "POST", body: JSON.stringify(said) });
