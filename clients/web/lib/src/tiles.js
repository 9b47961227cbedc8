// What vertices are made of by the engine: the charts of a garment in tiles, as drape/graph/packing.py lays them.
const TILE = 32; // charts of a tile
const ORDER = 4; // of the polynomials
const COLUMNS = 18; // numbers of a chart: its weight times rest place in the patch [patch scales] and basis
const PATCH = { centre: 9, scale: 12, numbers: 13 };
const MOST = 65535; // of numbers of two bytes

// The fields of the record Tiles. layout: unpackLayout's; put(kind, numbers): lays an array.
export function tilesOf({ count, vertices, charts, patches, rest, chart, chartPatch }, put) {
  if (charts !== 4) throw new Error(`expected a layout of 4 charts a vertex, got ${charts}`);
  const sizes = new Uint32Array(count);
  for (const patch of chartPatch) sizes[patch] += 1;
  const patchOf = [];
  const next = Array.from(sizes, (size, patch) => {
    const first = TILE * patchOf.length;
    for (let left = size; left > 0; left -= TILE) patchOf.push(patch);
    return first;
  });
  const columns = new Float32Array(COLUMNS * TILE * patchOf.length);
  const places = new Uint32Array(charts * vertices); // of each chart of all vertices, one chart after the other
  for (let entry = 0; entry < chartPatch.length; entry++) {
    const [vertex, own] = [Math.floor(entry / charts), PATCH.numbers * chartPatch[entry]];
    const place = next[chartPatch[entry]]++;
    places[(entry % charts) * vertices + vertex] = place;
    let at = COLUMNS * TILE * Math.floor(place / TILE) + (place % TILE);
    const add = (number) => {
      columns[at] = number;
      at += TILE;
    };
    const [weight, u, v] = chart.subarray(3 * entry, 3 * entry + 3);
    for (let i = 0; i < 3; i++) {
      let local = 0; // along the i-th axis of the patch at rest
      for (let a = 0; a < 3; a++) local += patches[own + 3 * a + i] * (rest[3 * vertex + a] - patches[own + PATCH.centre + a]);
      add((weight * local) / patches[own + PATCH.scale]);
    }
    for (let i = 0; i <= ORDER; i++) for (let j = 0; j <= i; j++) add(weight * u ** (i - j) * v ** j);
  }
  const scale = Float32Array.from({ length: count }, (_, patch) => patches[PATCH.numbers * patch + PATCH.scale]);
  const wide = TILE * patchOf.length > MOST;
  return {
    scale: put("numbers", scale),
    columns: put("numbers", columns),
    patch: put("int32s", patchOf),
    ...(wide ? { wide_charts: put("int32s", places) } : { charts: put("uint16s", places) }),
  };
}
