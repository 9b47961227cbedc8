// Decodes the frames of a stream of jets with folds made here, in Node.js or on a page; beside the library's modules.
import { Decoder, makeTargets } from "./decode.js";
import { Folding } from "./folding.js";
import { compiled } from "./folds.js";

const inNode = typeof process === "object";
const files = inNode ? await import("node:fs") : null;
const bytes = async (name) =>
  inNode ? new Uint8Array(files.readFileSync(new URL(name, import.meta.url))).buffer : (await fetch(name)).arrayBuffer();

const about = JSON.parse(new TextDecoder().decode(await bytes("about.json")));
const [layout, constants, messages, faces] = await Promise.all(["layout.bin", "constants.bin", "messages.bin", "faces.bin"].map(bytes));
const begun = performance.now();
const folding = await Folding.make({ module: await compiled(), constants });
const layers = [{ vertexCount: about.vertices, faces: new Uint32Array(faces), copies: new Uint32Array(0), layout }];
const decoder = new Decoder(layers, folding);
const startMs = performance.now() - begun;
let foldMs = 0;
const fold = folding.fold.bind(folding);
folding.fold = (...asked) => {
  const from = performance.now();
  const happened = fold(...asked);
  foldMs = performance.now() - from;
  return happened;
};
const targets = makeTargets(layers);
const found = new Float32Array(about.poses.length * 3 * about.vertices);
const network = about.exact ? new Float32Array(await bytes("network.bin")) : null; // frames as the service has them
const took = about.poses.map((pose, frame) => {
  if (network) {
    const { folds: steps, settle, cloth_contact: contact, clearance_m: clearanceM } = about.effort;
    const positions = found.subarray(frame * 3 * about.vertices, (frame + 1) * 3 * about.vertices);
    positions.set(network.subarray(frame * 3 * about.vertices, (frame + 1) * 3 * about.vertices));
    folding.fold(positions, { pose, timeS: frame / about.fps, steps, settle, contact, clearanceM });
    return [foldMs, foldMs];
  }
  const message = messages.slice(frame * about.message_bytes, (frame + 1) * about.message_bytes);
  const from = performance.now();
  decoder.decode(message, targets, { pose, effort: about.effort });
  const frameMs = performance.now() - from;
  found.set(targets[0].positions, frame * 3 * about.vertices);
  return [frameMs, foldMs];
});
const said = JSON.stringify({ start_ms: startMs, took });
if (inNode) {
  files.writeFileSync(new URL("vertices.bin", import.meta.url), found);
  console.log(said);
} else {
  await fetch("vertices.bin", { method: "POST", body: found });
  await fetch("said.json", { method: "POST", body: said });
}
