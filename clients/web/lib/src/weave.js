// The surface of a cloth, yarn by yarn: its relief as a normal map, its shade as a map, and a swatch of both.
import { DataTexture, LinearFilter, LinearMipmapLinearFilter, RepeatWrapping, RGBAFormat } from "three";

export const YARNS = 32; // along each side of a tile
const SIZE = 256; // pixels along each side
const PER_YARN = SIZE / YARNS;
const SLUB_CELLS = 16; // of the unevenness that the alpha of a normal map holds

// A number in [0, 1) for two integers, the same each time.
function hash(i, j) {
  let h = (Math.imul(i, 374761393) + Math.imul(j, 668265263)) | 0;
  h = Math.imul(h ^ (h >>> 13), 1274126177);
  return ((h ^ (h >>> 16)) >>> 0) / 4294967296;
}

const wrap = (i, count) => ((i % count) + count) % count;
const mix = (a, b, share) => a + (b - a) * share;

// Noise of that many cells along each side of a tile, smooth and without a border; x and y in tiles.
function noise(x, y, cells, seed) {
  const [i, j] = [Math.floor(x * cells), Math.floor(y * cells)];
  const ease = (t) => t * t * (3 - 2 * t);
  const [u, v] = [ease(x * cells - i), ease(y * cells - j)];
  const at = (a, b) => hash(wrap(i + a, cells) + seed, wrap(j + b, cells) - seed);
  return mix(mix(at(0, 0), at(1, 0), u), mix(at(0, 1), at(1, 1), u), v);
}

const round = (across) => Math.sqrt(Math.max(0, 1 - (2 * across - 1) ** 2)); // a yarn's cross section

// Warp and weft that cross: rises(i, j), whether the warp lies above there. warp: whether it is what is seen.
function woven(rises) {
  return (u, v) => {
    const [i, j] = [Math.floor(u), Math.floor(v)];
    const [fx, fy] = [u - i, v - j];
    const above = (a, b) => (rises(wrap(a, YARNS), wrap(b, YARNS)) ? 1 : 0);
    const ahead = fy < 0.5 ? mix(above(i, j - 1), above(i, j), fy + 0.5) : mix(above(i, j), above(i, j + 1), fy - 0.5);
    const aside = fx < 0.5 ? mix(above(i - 1, j), above(i, j), fx + 0.5) : mix(above(i, j), above(i + 1, j), fx - 0.5);
    const warp = round(fx) * (0.4 + 0.6 * ahead);
    const weft = round(fy) * (1 - 0.6 * aside);
    return { height: Math.max(warp, weft), warp: warp >= weft };
  };
}

// Loops in columns: each is a V whose legs go up and apart.
function knitted(u, v, columns = 0) {
  const fx = u - Math.floor(u);
  const leg = (fy) => 1 - ((Math.abs(fx - 0.5) - (0.1 + 0.27 * fy)) / 0.2) ** 2;
  const fy = v - Math.floor(v);
  const height = Math.sqrt(Math.max(0, leg(fy), 0.8 * leg(fy + 1), 0.8 * leg(fy - 1)));
  const raised = columns ? 0.5 + 0.5 * Math.cos((2 * Math.PI * u) / columns) : 0;
  return { height: columns ? 0.35 * height + 1.6 * raised ** 0.7 : height, warp: true };
}

function fleece(u, v) {
  const [x, y] = [u / YARNS, v / YARNS];
  const height = 0.5 * noise(x, y, 16, 3) + 0.35 * noise(x, y, 48, 5) + 0.25 * noise(x, y, 128, 7);
  return { height, warp: true };
}

const BONDS = {
  plain: woven((i, j) => (i + j) % 2 === 0),
  twill: woven((i, j) => wrap(i - j, 4) < 3), // a tile holds whole repeats
  satin: woven((i, j) => wrap(3 * i + j, 8) !== 0),
  jersey: (u, v) => knitted(u, v),
  rib: (u, v) => knitted(u, v, 4),
  fleece,
};
export const BOND_NAMES = Object.keys(BONDS);

// Heights in [0, 1] and shades of the pixels of a tile. pale: how much lighter the weft is, as of denim.
function surface(bond, pale) {
  const heights = new Float32Array(SIZE * SIZE);
  const shades = new Float32Array(SIZE * SIZE);
  for (let y = 0, at = 0; y < SIZE; y++) {
    for (let x = 0; x < SIZE; x++, at++) {
      const [u, v] = [(x + 0.5) / PER_YARN, (y + 0.5) / PER_YARN];
      const { height, warp } = BONDS[bond](u, v);
      const yarn = warp ? hash(Math.floor(u), 11 + Math.floor(v / 8)) : hash(17 + Math.floor(u / 8), Math.floor(v));
      heights[at] = height;
      shades[at] = (0.62 + 0.38 * Math.min(1, height)) * (0.96 + 0.08 * yarn) * (warp ? 1 : 1 + pale);
    }
  }
  return { heights, shades };
}

const kept = new Map();

// { normal, shade } of a bond, textures of one tile; each is made once.
export function weaveTextures(bond, { relief = 1, pale = 0 } = {}) {
  const key = `${bond} ${relief} ${pale}`;
  if (!kept.has(key)) kept.set(key, makeTextures(bond, relief, pale));
  return kept.get(key);
}

function makeTextures(bond, relief, pale) {
  const { heights, shades } = surface(bond, pale);
  const normal = new Uint8Array(4 * SIZE * SIZE);
  const shade = new Uint8Array(4 * SIZE * SIZE);
  const mean = shades.reduce((sum, one) => sum + one, 0) / shades.length; // so that a dye keeps its lightness
  for (let y = 0, at = 0; y < SIZE; y++) {
    for (let x = 0; x < SIZE; x++, at++) {
      const height = (a, b) => heights[wrap(y + b, SIZE) * SIZE + wrap(x + a, SIZE)];
      const nx = (-relief * PER_YARN * (height(1, 0) - height(-1, 0))) / 8;
      const ny = (-relief * PER_YARN * (height(0, 1) - height(0, -1))) / 8;
      const length = Math.hypot(nx, ny, 1);
      const slub = 0.5 * noise(x / SIZE, y / SIZE, SLUB_CELLS, 23) + 0.5 * noise(x / SIZE, y / (3 * SIZE), SLUB_CELLS, 29);
      normal.set([127.5 + (127.5 * nx) / length, 127.5 + (127.5 * ny) / length, 127.5 + 127.5 / length, 255 * slub], 4 * at);
      const grey = Math.min(255, (200 * shades[at]) / mean);
      shade.set([grey, grey, grey, 255], 4 * at);
    }
  }
  return { normal: texture(normal), shade: texture(shade) };
}

function texture(bytes) {
  const made = new DataTexture(bytes, SIZE, SIZE, RGBAFormat);
  made.wrapS = made.wrapT = RepeatWrapping;
  made.magFilter = LinearFilter;
  made.minFilter = LinearMipmapLinearFilter;
  made.generateMipmaps = true;
  made.anisotropy = 4;
  made.needsUpdate = true;
  return made;
}

// RGBA of a swatch, size pixels along each side and that many yarns across, in a colour (r, g, b of 0 to 255), lit from above left.
export function swatchPixels(bond, { colour, size, yarns, relief = 1, pale = 0 }) {
  const pixels = new Uint8ClampedArray(4 * size * size);
  const step = yarns / size;
  for (let y = 0, at = 0; y < size; y++) {
    for (let x = 0; x < size; x++, at += 4) {
      const [u, v] = [x * step, (size - y) * step];
      const { height, warp } = BONDS[bond](u, v);
      const lit = (BONDS[bond](u - step, v + step).height - height) * relief * 0.35;
      const shade = 0.78 + 0.22 * Math.min(1, height) - lit;
      for (let k = 0; k < 3; k++) pixels[at + k] = shade * (warp ? colour[k] : mix(colour[k], 255, pale));
      pixels[at + 3] = 255;
    }
  }
  return pixels;
}
