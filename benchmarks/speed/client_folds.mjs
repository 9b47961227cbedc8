// Decodes the frames of a stream of jets with swing and folds made here, in Node.js or on a page; beside the library's modules.
import { Decoder, makeTargets } from "./decode.js";
import { Folding } from "./folding.js";
import { compiled } from "./folds.js";
import { unpackJets } from "./wire.js";

const inNode = typeof process === "object";
const files = inNode ? await import("node:fs") : null;
const bytes = async (name) =>
  inNode ? new Uint8Array(files.readFileSync(new URL(name, import.meta.url))).buffer : (await fetch(name)).arrayBuffer();

const about = JSON.parse(new TextDecoder().decode(await bytes("about.json")));
const [layout, constants, messages, faces] = await Promise.all(["layout.bin", "constants.bin", "messages.bin", "faces.bin"].map(bytes));
const begun = performance.now();
const folding = await Folding.make({ module: await compiled(), constants }, layout);
const layers = [{ vertexCount: about.vertices, faces: new Uint32Array(faces), copies: new Uint32Array(0), layout }];
const decoder = new Decoder(layers, folding);
const startMs = performance.now() - begun;
let movedMs = 0; // swing and folds
const moved = folding.moved.bind(folding);
folding.moved = (...asked) => {
  const from = performance.now();
  const array = moved(...asked);
  movedMs = performance.now() - from;
  return array;
};
const targets = makeTargets(layers);
const found = new Float32Array(about.poses.length * 3 * about.vertices);
const network = about.exact ? new Float32Array(await bytes("network.bin")) : null; // frames as the service has them
const took = about.poses.map((pose, frame) => {
  const message = messages.slice(frame * about.message_bytes, (frame + 1) * about.message_bytes);
  const own = [frame * 3 * about.vertices, (frame + 1) * 3 * about.vertices];
  const from = performance.now();
  if (network) {
    folding.skin(pose);
    folding.engine.view(folding.smooth).set(network.subarray(...own));
    const array = folding.moved(unpackJets(message).header.root, frame / about.fps, about.effort.folds, about.effort);
    found.set(folding.engine.view(array), own[0]);
  } else {
    decoder.decode(message, targets, { pose, effort: about.effort });
    found.set(targets[0].positions, own[0]);
  }
  return [performance.now() - from, movedMs];
});
const said = JSON.stringify({ start_ms: startMs, took });
if (inNode) {
  files.writeFileSync(new URL("vertices.bin", import.meta.url), found);
  console.log(said);
} else {
  await fetch("vertices.bin", { method: "POST", body: found });
  await fetch("said.json", { method: "POST", body: said });
}
