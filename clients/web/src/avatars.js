// Characters of the user's: sent to the service, and kept in this browser, as the service does not give their files back.
import { readCharacter } from "../lib/src/character.js";

const STORE = "drape-characters";

const address = (id) => `/characters/${encodeURIComponent(id)}`;

async function store() {
  return globalThis.caches ? caches.open(STORE) : null; // none where the page is not on a secure origin
}

const fresh = new Map(); // by id, of this visit

// The id of a character's file when garments can be cut for it, and made of its own clothes; seconds.
export async function sendCharacter(drape, file) {
  const bytes = await file.arrayBuffer();
  const id = await drape.avatar(bytes, file.name, { alive: true });
  fresh.set(id, bytes);
  await (await store())?.put(address(id), new Response(bytes)).catch(() => {}); // full: it lasts for this visit
  return id;
}

// The bytes of the file of the character with this id; undefined where this browser does not have it.
export async function charactersFile(id) {
  return fresh.get(id) ?? (await (await (await store())?.match(address(id)))?.arrayBuffer());
}

// The character that the service tells avatar of, as an object that poses itself, or as nothing but its joints where this
// browser does not have its file.
export async function findCharacter(avatar) {
  const kept = await charactersFile(avatar.id);
  if (kept) return readCharacter(kept, avatar);
  return { object: null, rest: avatar.rest_joints, pose: null };
}
