// Boxes around clusters of LANES points or triangles. A copy of drape/live/clusters.py for browsers.
import { LANES, QUAD, ROW, ZERO, all, most, sub, square, whole } from "./vectors";

export const POINT_ROWS: i32 = 3 * ROW, BOX_ROWS: i32 = 6 * ROW; // bytes of a cluster's points, of LANES boxes

@inline export function boxBytes(count: i32): usize { return <usize>(BOX_ROWS * ((count + LANES - 1) / LANES)); }

function noBoxes(count: i32, boxes: usize): void {
  const far = all(f32.MAX_VALUE * 2), end = boxes + boxBytes(count);
  for (let block = boxes; block < end; block += BOX_ROWS) {
    for (let entry = 0; entry < POINT_ROWS; entry += QUAD) {
      v128.store(block + entry, far);
      v128.store(block + POINT_ROWS + entry, f32x4.neg(far));
    }
  }
}

// The boxes around clusters of size bytes of rows, and the boxes around groups of LANES of those.
export function boxesAround(rows: usize, count: i32, size: i32, low: i32, high: i32, boxes: usize, groups: usize): void {
  noBoxes(count, boxes);
  for (let c = 0; c < count; c++) enclose(rows + size * c + low, rows + size * c + high, boxes, c);
  const many = (count + LANES - 1) / LANES;
  noBoxes(many, groups);
  for (let g = 0; g < many; g++) enclose(boxes + BOX_ROWS * g, boxes + BOX_ROWS * g + POINT_ROWS, groups, g);
}

@inline function leastOf(p: usize): f32 {
  const a = f32x4.pmin(f32x4.pmin(v128.load(p), v128.load(p, 16)), f32x4.pmin(v128.load(p, 32), v128.load(p, 48)));
  return min<f32>(
    min<f32>(f32x4.extract_lane(a, 0), f32x4.extract_lane(a, 1)), min<f32>(f32x4.extract_lane(a, 2), f32x4.extract_lane(a, 3)),
  );
}
@inline function mostOf(p: usize): f32 {
  const a = f32x4.pmax(f32x4.pmax(v128.load(p), v128.load(p, 16)), f32x4.pmax(v128.load(p, 32), v128.load(p, 48)));
  return max<f32>(
    max<f32>(f32x4.extract_lane(a, 0), f32x4.extract_lane(a, 1)), max<f32>(f32x4.extract_lane(a, 2), f32x4.extract_lane(a, 3)),
  );
}

function enclose(lowest: usize, highest: usize, boxes: usize, c: i32): void {
  const to = boxes + BOX_ROWS * (c / LANES) + (<usize>(c % LANES) << 2);
  for (let axis = 0; axis < 3; axis++) {
    store<f32>(to + axis * ROW, leastOf(lowest + axis * ROW));
    store<f32>(to + (3 + axis) * ROW, mostOf(highest + axis * ROW));
  }
}

// The boxes of a block, of whose LANES bits those within the root of reach2 of the box own are set.
function hits(own: usize, block: usize, reach2: v128): i32 {
  let found = 0;
  for (let q = 0; q < 4; q++) {
    const p = block + q * QUAD;
    const x = most(most(sub(v128.load(p), v128.load32_splat(own + 3 * ROW)), sub(v128.load32_splat(own), v128.load(p + 3 * ROW))), ZERO);
    const y = most(most(sub(v128.load(p + ROW), v128.load32_splat(own + 4 * ROW)), sub(v128.load32_splat(own + ROW), v128.load(p + 4 * ROW))), ZERO);
    const z = most(most(sub(v128.load(p + 2 * ROW), v128.load32_splat(own + 5 * ROW)), sub(v128.load32_splat(own + 2 * ROW), v128.load(p + 5 * ROW))), ZERO);
    found |= i32x4.bitmask(f32x4.lt(square(x, y, z), reach2)) << (4 * q);
  }
  return found;
}

// How many of the clusters a to count - 1 have a box within the root of reach2 of that of a; they are written to found.
export function findClose(a: i32, count: i32, boxes: usize, groups: usize, reach2: f32, found: usize): i32 {
  const own = boxes + BOX_ROWS * (a / LANES) + (<usize>(a % LANES) << 2), within = all(reach2);
  const many = (count + LANES - 1) / LANES, blocks = (many + LANES - 1) / LANES;
  let filled = 0;
  for (let block = a / (LANES * LANES); block < blocks; block++) {
    const near = hits(own, groups + BOX_ROWS * block, within);
    for (let i = 0; i < LANES; i++) {
      const group = LANES * block + i;
      if (!(near & (1 << i)) || group < a / LANES || group >= many) continue;
      const hit = hits(own, boxes + BOX_ROWS * group, within);
      if (!hit) continue;
      for (let j = 0; j < LANES; j++) {
        const c = LANES * group + j;
        if ((hit & (1 << j)) && a <= c && c < count) {
          store<i32>(found + (<usize>filled << 2), c);
          filled += 1;
        }
      }
    }
  }
  return filled;
}
