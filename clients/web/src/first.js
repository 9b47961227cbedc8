// What the fitting room shows first, and its questions, asked while its scripts come.
import { Rest } from "../lib/src/rest.js";
import { key } from "./service.js";

const WORN = "trousers,tshirt"; // where the address names nothing, the innermost first
const CLIP = "walk";
const MOVING = 2; // frames
const LATEST_MS = 10_000;

// garment=inner,outer, clip, tier, folds_by, passes, folds, resolution, fabric, size, jets, quality=high
export const wanted = new URLSearchParams(location.search);

// Ids of the garments to wear of those that ids name: at most limit of them, the outermost ones, and one at the least.
export function wornFirst(garments, limit, ids = (wanted.get("garment") ?? WORN).split(",")) {
  const known = new Set(garments.map(({ id }) => id));
  const kept = [...new Set(ids)].filter((id) => known.has(id)).slice(-limit);
  return kept.length ? kept : garments.slice(0, 1).map(({ id }) => id);
}

// The id of the clip to play.
export const clipFirst = (clips) => [wanted.get("clip"), CLIP, clips[0]?.id].find((id) => clips.some((clip) => clip.id === id));

let moves;
// Is kept when cloth moves, or when it may not come to it any more: what is shown besides waits.
export const moving = new Promise((resolve) => (moves = resolve));
setTimeout(moves, LATEST_MS);

// A frame more is drawn.
export function countFrame() {
  const frames = Number(document.body.dataset.frames) + 1;
  document.body.dataset.frames = String(frames);
  if (frames !== MOVING) return;
  performance.mark("moving");
  moves();
}

const begun = new Map(); // answers that nobody has taken yet, by what was asked for
const nameOf = (address, { headers } = {}) => `${address} ${headers?.Accept ?? ""}`;

// Asks as fetch() does, and takes the answer to a question that was asked early.
export function asked(address, options) {
  const name = nameOf(address, options);
  const answer = options?.method ? null : begun.get(name);
  begun.delete(name);
  return answer ?? fetch(address, options);
}

function ask(address, options) {
  const answer = fetch(address, options);
  begun.set(nameOf(address, options), answer);
  return answer.then((one) => one.clone());
}

// What fails here is asked again, and told then. painted: a promise, before which nothing large is asked for.
export async function askEarly(painted) {
  const rest = new Rest(location.origin, { key, fetch: ask });
  const [{ body, layers }, garments, clips] = await Promise.all([rest.health(), rest.garments(), rest.motions()]);
  const resolution = wanted.get("resolution") || undefined;
  const worn = wornFirst(garments, layers);
  const brief = Promise.allSettled([rest.tiers(), rest.fabrics(), ...worn.map((id) => rest.garment(id))]); // opens the stream
  await painted;
  const meshes = wanted.has("size") ? [] : worn.map((id) => rest.garmentMesh(id, { resolution }));
  await Promise.all([brief, rest.avatars(), rest.measures(body), rest.motion(clipFirst(clips)), ...meshes, rest.bodyFile(body)]);
}
