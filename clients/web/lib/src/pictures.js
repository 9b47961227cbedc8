// The pictures of a garment's own materials, on the cloth of its fabric.
import { Color, RepeatWrapping, SRGBColorSpace, Texture, Vector2 } from "three";
import { dye } from "./materials.js";

const SLOTS = { base_colour: ["map"], normal: ["normalMap"], metallic_roughness: ["roughnessMap", "metalnessMap"] };

// What a garment's materials need: { materials, runs, bitmaps }; null where none has a picture and it is dyed. A picture that
// does not come is left out.
export async function fetchPictures(rest, id, resolution) {
  const { materials, runs } = await rest.garmentLooks(id, { resolution });
  const numbers = [...new Set(materials.flatMap((one) => Object.values(one?.pictures ?? {})))];
  if (!numbers.length && !id.includes("~")) return null; // what a character came in keeps its colours
  const bitmap = async (number) => createImageBitmap(await rest.garmentTexture(id, number), { colorSpaceConversion: "none" });
  const fetched = await Promise.all(numbers.map((number) => bitmap(number).catch(() => null)));
  return { materials, runs, bitmaps: new Map(numbers.map((number, i) => [number, fetched[i]])) };
}

// Groups the triangles of a geometry by material.
export function groupByMaterial(geometry, { runs }) {
  geometry.clearGroups();
  for (const [start, count, material] of runs) geometry.addGroup(3 * start, 3 * count, material);
}

// A cloth's material as its file has it; look: one of the garment's materials, null where it is dyed as any cloth.
export function withPictures(material, look, bitmaps) {
  if (!look) return material;
  const [r, g, b, alpha] = look.base_colour;
  dye(material, new Color(r, g, b));
  material.userData.own = true;
  material.map = null; // the shade of the weave is the picture's
  if (look.alpha_mode === "BLEND") Object.assign(material, { transparent: true, opacity: alpha });
  if (look.alpha_mode === "MASK") material.alphaTest = look.alpha_cutoff;
  if ("roughness" in material) Object.assign(material, { roughness: look.roughness, metalness: look.metallic, sheen: 0.15 });
  for (const [slot, number] of Object.entries(look.pictures)) {
    const bitmap = bitmaps.get(number);
    const places = SLOTS[slot].filter((place) => place in material);
    if (!bitmap || !places.length) continue;
    const texture = new Texture(bitmap);
    Object.assign(texture, { wrapS: RepeatWrapping, wrapT: RepeatWrapping, anisotropy: 8, flipY: false, matrixAutoUpdate: false });
    texture.matrix.set(...placing(look));
    if (slot === "base_colour") texture.colorSpace = SRGBColorSpace;
    texture.needsUpdate = true;
    for (const place of places) material[place] = texture;
    if (slot === "normal") material.normalScale = new Vector2(1, -1); // its rows run downwards
  }
  return material;
}

// From our texture coordinates, whose origin is at the lower left, to those of a glTF picture (KHR_texture_transform).
function placing({ offset: [x, y], rotation, scale: [sx, sy] }) {
  const [c, s] = [Math.cos(rotation), Math.sin(rotation)];
  return [c * sx, -s * sy, x + s * sy, -s * sx, -c * sy, y + c * sy, 0, 0, 1];
}
