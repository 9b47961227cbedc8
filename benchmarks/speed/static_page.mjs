// Drapes poses without a service, frame by frame, beside the library's modules in a folder of python -m service.static: in
// Node.js or on a page.
import { makeTargets } from "./decode.js";
import { filesOf } from "./files.js";
import { LocalDecoder } from "./local_decoder.js";
import { unpackMesh } from "./meshes.js";
import { packPose } from "./wire.js";

const inNode = typeof process === "object";
const disk = inNode ? await import("node:fs") : null;
const { gunzipSync } = inNode ? await import("node:zlib") : {};
const base = new URL("./", import.meta.url).href;
const read = (name) => {
  const bytes = disk.readFileSync(new URL(name, base));
  return new Uint8Array(name.endsWith(".gz") ? gunzipSync(bytes) : bytes).buffer;
};
const file = inNode ? async (name) => read(name) : filesOf(base);
const json = async (name) => JSON.parse(new TextDecoder().decode(await file(name)));

async function measured() {
  const [about, asked] = await Promise.all([json("about.json"), json("asked.json")]);
  const garment = `/garments/${about.garment}`;
  const [layout, constants, mesh] = await Promise.all([
    file(about.answers[`${garment}/jets`]), file(about.answers[`${garment}/folds`]), file(about.answers[`${garment}/mesh`]),
  ]);
  const layers = [{ ...unpackMesh(mesh), layout }];
  const begun = performance.now();
  const module = await WebAssembly.compile(await file(about.engine));
  const decoder = await LocalDecoder.make({ about, file }, layers, { module, constants });
  const startMs = performance.now() - begun;
  const { folding } = decoder.decoder;
  let drapedMs = 0;
  const drape = folding.drape.bind(folding);
  folding.drape = (...given) => {
    const from = performance.now();
    drape(...given);
    drapedMs = performance.now() - from;
  };
  const targets = makeTargets(layers);
  const count = 3 * layers[0].vertexCount;
  const found = new Float32Array(asked.poses.length * count);
  const took = [];
  for (const [number, pose] of asked.poses.entries()) {
    const message = packPose({ sequence: number, clientTimeS: number / asked.fps, trans: asked.trans[number], pose });
    const from = performance.now();
    decoder.decode(message, targets, { effort: { ...about.opened, ...asked.effort } });
    took.push([performance.now() - from, drapedMs]);
    found.set(targets[0].positions.subarray(0, count), number * count);
  }
  if (inNode) disk.writeFileSync(new URL("vertices.bin", base), found);
  else await fetch("vertices.bin", { method: "POST", body: found });
  return { start_ms: startMs, took };
}

const said = await measured().catch((error) => ({ error: error.stack }));
if (inNode) console.log(JSON.stringify(said));
else await fetch("said.json", { method: "POST", body: JSON.stringify(said) });
