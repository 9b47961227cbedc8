// Files that are dropped anywhere, or chosen: what they are, and which of them are one thing.
import { BESIDE_SUFFIXES, MESH_SUFFIXES } from "../lib/src/wire.js";
import { aboutGlb, fbxHasMesh } from "./scene_file.js";
import { element, failing } from "./words.js";

const ALONE = [".glb", ".stl", ".zip", ".vrm", ".usdz"]; // name no other files
const MOTIONS = [".bvh", ".npz", ".vrma"];
const MESHES = MESH_SUFFIXES.split(",");
const BESIDE = BESIDE_SUFFIXES.split(",");
const MOST_FILES = 1000; // as the service takes in a form

const suffixOf = (name) => /\.[^./]+$/.exec(name.toLowerCase())?.[0] ?? "";
const folderOf = (path) => path.slice(0, path.lastIndexOf("/") + 1);

// "garment", "character", "motion" or "beside", a file that a garment names; null for anything else. A GLB with a skin is a
// character; what has an animation and no mesh, a motion.
export async function kindOfFile(file) {
  const suffix = suffixOf(file.name);
  if (MOTIONS.includes(suffix)) return "motion";
  if (suffix === ".vrm") return "character";
  if (suffix === ".fbx") return (await fbxHasMesh(file)) ? "garment" : "motion";
  if (suffix === ".glb") {
    const { skin, mesh, clips } = await aboutGlb(file);
    if (clips.length && !mesh) return "motion";
    if (skin) return "character";
  }
  if (BESIDE.includes(suffix)) return "beside";
  return MESHES.includes(suffix) ? "garment" : null;
}

// The things that came as parts, { file, path } of each, path within what was dropped: { kind, parts } of each thing, its own
// file first. A garment has the files beside it and below: all of them where it is the only one.
export async function things(parts, kindOf = kindOfFile) {
  const kinds = await Promise.all(parts.map(({ file }) => kindOf(file)));
  const own = parts.map((part, i) => ({ kind: kinds[i], parts: [part] })).filter(({ kind }) => kind && kind !== "beside");
  const beside = parts.filter((_, i) => kinds[i] === "beside");
  const garments = own.filter(({ kind, parts: [{ path }] }) => kind === "garment" && !ALONE.includes(suffixOf(path)));
  for (const { parts: mine } of garments) {
    const near = garments.length === 1 ? beside : beside.filter(({ path }) => path.startsWith(folderOf(mine[0].path)));
    mine.push(...near.slice(0, MOST_FILES - 1));
  }
  if (own.length) return own;
  return parts.slice(0, 1).map((part) => ({ kind: beside.length ? "beside" : null, parts: [part] }));
}

// The things in a file chooser whose files are garments, whatever else they might be, or what garments name.
export const chosenGarments = (files) =>
  things([...files].map((file) => ({ file, path: file.name })), async (file) => (BESIDE.includes(suffixOf(file.name)) ? "beside" : "garment"));

// Every file of what was dropped, folders opened; entries have to be taken before the event ends.
function partsOf(transfer) {
  const items = [...transfer.items].filter(({ kind }) => kind === "file");
  return Promise.all(items.map((item) => (item.webkitGetAsEntry?.() ? below(item.webkitGetAsEntry(), "") : [whole(item.getAsFile())]))).then((all) => all.flat());
}

const whole = (file) => ({ file, path: file.name });

async function below(entry, folder) {
  const path = folder + entry.name;
  if (entry.isFile) return [{ file: await new Promise((done, fail) => entry.file(done, fail)), path }];
  const reader = entry.createReader();
  const found = [];
  for (let some; (some = await new Promise((done, fail) => reader.readEntries(done, fail))).length && found.length < MOST_FILES; ) found.push(...some);
  const shown = found.filter(({ name }) => !name.startsWith(".") && name !== "__MACOSX");
  return (await Promise.all(shown.map((one) => below(one, `${path}/`)))).flat();
}

// take(thing) for each thing that is dropped, one after the other.
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
  const takeAll = failing(async (parts) => {
    for (const thing of await things(await parts)) await take(thing);
  });
  addEventListener("drop", (event) => {
    if (!carries(event)) return;
    event.preventDefault();
    depth = 0;
    show(0);
    takeAll(partsOf(event.dataTransfer));
  });
}
