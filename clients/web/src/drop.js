// Files that are dropped anywhere: what they are, and who takes them.
import { MESH_SUFFIXES } from "../lib/src/wire.js";
import { element } from "./words.js";

const HEAD = { magic: 0x46546c67, json: 20 }; // of a GLB: its mark, where its JSON begins

// "garment", "character" or "motion"; null for anything else. A GLB with a skin is a character.
export async function kindOfFile(file) {
  const suffix = /\.[^.]+$/.exec(file.name.toLowerCase())?.[0] ?? "";
  if (suffix === ".bvh" || suffix === ".npz") return "motion";
  if (suffix === ".vrm") return "character";
  if (suffix === ".glb" && (await hasSkin(file))) return "character";
  return MESH_SUFFIXES.split(",").includes(suffix) ? "garment" : null;
}

async function hasSkin(file) {
  const head = new DataView(await file.slice(0, HEAD.json).arrayBuffer());
  if (head.byteLength < HEAD.json || head.getUint32(0, true) !== HEAD.magic) return false;
  const text = await file.slice(HEAD.json, HEAD.json + head.getUint32(12, true)).text();
  try {
    return (JSON.parse(text).skins ?? []).length > 0;
  } catch {
    return false; // the service will say what is wrong with it
  }
}

// take(kind, file) for each file.
export function acceptDrops(take) {
  let depth = 0; // of elements that the pointer is over
  const carries = (event) => event.dataTransfer?.types.includes("Files");
  const show = (change) => {
    depth = Math.max(0, depth + change);
    element("drop").hidden = depth === 0;
  };
  addEventListener("dragenter", (event) => carries(event) && show(1));
  addEventListener("dragleave", (event) => carries(event) && show(-1));
  addEventListener("dragover", (event) => carries(event) && event.preventDefault());
  addEventListener("drop", async (event) => {
    if (!carries(event)) return;
    event.preventDefault();
    depth = 0;
    show(0);
    for (const file of [...event.dataTransfer.files]) await take(await kindOfFile(file), file);
  });
}
