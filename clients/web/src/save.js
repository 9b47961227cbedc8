// The motion as a file: the garments on the service's body, or the user's character in them.
import { charactersFile } from "./avatars.js";
import { sampled } from "./motions.js";
import { clipFile } from "./service.js";
import { say } from "./words.js";

const UNSEEN_M = 0.15; // below cloth, and so far from its hems, nobody sees a face: players draw none of them deeper

// Saves what is worn (an object of the library) by document, a POST /drape with garments and without poses, over clip.
export async function saveMotion(drape, worn, { garments, geometry, folds_by, ...options }, clip) {
  say("The service writes the file …");
  const asked = { ...(garments.length ? { garments } : {}), ...options, ...sampled(clip) };
  const { file, whole } = await fileOf(drape.rest, worn, asked);
  const link = document.createElement("a");
  link.href = URL.createObjectURL(file);
  link.download = `${garments.join("-") || asked.avatar}-${clip.id}.glb`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
  say(whole ? `Saved ${link.download}.` : `Saved ${link.download} without the character, whose file this browser does not have.`);
}

// { file, whole }: a GLB, and whether everybody is in it who is on the page.
async function fileOf(rest, { wearing }, asked) {
  if (!asked.avatar) return { file: await clipFile(rest, { ...asked, body: true }), whole: true };
  const ids = wearing.layers.map(({ id }) => id);
  const bytes = await charactersFile(asked.avatar);
  const [file, covered] = await Promise.all([
    clipFile(rest, { ...asked, rig: true }),
    bytes && rest.covered(asked.avatar, ids, ids.map((id) => wearing.sizeOf(id)), UNSEEN_M),
  ]);
  if (!bytes) return { file, whole: false };
  const { wornFile } = await import("./worn_file.js");
  return { file: wornFile(bytes, await file.arrayBuffer(), covered), whole: true };
}
