// Cloth that comes near to itself is kept apart. A copy of drape/live/room.py for browsers.
import * as A from "./arrays";
import { at, constant, reserved } from "./arrays";
import { POINT_ROWS, boxBytes, boxesAround, findClose } from "./clusters";
import { OTHER_PLANE, PLANES } from "./sweeps";
import { LANES, QUAD, ROW, all, ax, ay, az, least, mul, number, square, sub, whole } from "./vectors";

const SPACING: f32 = 0.95, ROOM_M: f32 = 0.018, KEPT: f32 = 0.5, KEPT_M: f32 = 0.0085;
const FREE: f64 = 255;
const BOUND_M2: f32 = <f32>(0.018 * 0.018 / (FREE - 1));

const nearest: usize = memory.data(64, 16);

@inline export function roomBytes(clusters: i32): usize {
  return <usize>clusters * (POINT_ROWS + 2 * ROW + 8) + boxBytes(clusters) + boxBytes((clusters + LANES - 1) / LANES) + 64;
}

// Writes the planes that keep x apart to those of other parts in planes.
export function keepApart(x: usize, planes: usize, room: usize): void {
  const reach: f32 = min<f32>(SPACING / constant(A.PER_EDGE), ROOM_M), far = reach * reach;
  const count = reserved(A.CLUSTERS) / LANES, squares = rooms(x, count, far, room), which = squares + <usize>count * ROW;
  const clusters = at(A.CLUSTERS), place = at(A.PLACE), gap = constant(A.GAP);
  const kept: f32 = min<f32>(KEPT / constant(A.PER_EDGE), KEPT_M);
  for (let e = 0; e < LANES * count; e++) {
    // Lanes that repeat a vertex come after its own: each vertex has one plane.
    if (e % LANES > 0 && whole(clusters, e) == whole(clusters, e - 1)) continue;
    const near = number(squares, e);
    if (!(near < far)) continue;
    const v = whole(place, whole(clusters, e)), u = whole(place, whole(clusters, whole(which, e)));
    const hx = ax(x, v), hy = ay(x, v), hz = az(x, v);
    fromTriangles(x, u, hx, hy, hz);
    const d: f32 = Mathf.sqrt(wx * wx + wy * wy + wz * wz), height: f32 = 0.5 * (d - kept) + gap; // contact begins a gap over the plane
    if (!(d > 0 && d < kept)) continue;
    const nx = wx / d, ny = wy / d, nz = wz / d;
    const to = planes + (v / LANES) * PLANES + OTHER_PLANE + (<usize>(v % LANES) << 2);
    const ox = load<f32>(to, 3 * ROW), oy = load<f32>(to, 4 * ROW), oz = load<f32>(to, 5 * ROW);
    const over = (hx - load<f32>(to)) * ox + (hy - load<f32>(to, ROW)) * oy + (hz - load<f32>(to, 2 * ROW)) * oz;
    if (ox * ox + oy * oy + oz * oz > 0 && over < height) continue;
    store<f32>(to, hx - height * nx);
    store<f32>(to, hy - height * ny, ROW);
    store<f32>(to, hz - height * nz, 2 * ROW);
    store<f32>(to, nx, 3 * ROW);
    store<f32>(to, ny, 4 * ROW);
    store<f32>(to, nz, 5 * ROW);
  }
}

// The shortest way to a point from the triangles of the place u.
let wx: f32 = 0, wy: f32 = 0, wz: f32 = 0;

function fromTriangles(x: usize, u: i32, px: f32, py: f32, pz: f32): void {
  const ux = ax(x, u), uy = ay(x, u), uz = az(x, u), ox = px - ux, oy = py - uy, oz = pz - uz;
  const first = whole(at(A.FAN_START), u / LANES), end = whole(at(A.FAN_START), u / LANES + 1);
  wx = ox; wy = oy; wz = oz;
  for (let row = first; row < end; row++) {
    const entry = at(A.FAN_OTHER) + <usize>(2 * row) * ROW, lane = u % LANES;
    const v = whole(entry, lane), w = whole(entry + ROW, lane);
    const cx = ax(x, v) - ux, cy = ay(x, v) - uy, cz = az(x, v) - uz;
    const dx = ax(x, w) - ux, dy = ay(x, w) - uy, dz = az(x, w) - uz;
    const cc = cx * cx + cy * cy + cz * cz, cd = cx * dx + cy * dy + cz * dz, dd = dx * dx + dy * dy + dz * dz;
    const co = cx * ox + cy * oy + cz * oz, od = dx * ox + dy * oy + dz * oz;
    const s = dd * co - cd * od, t = cc * od - cd * co, area = cc * dd - cd * cd;
    if (s >= 0 && t >= 0 && s + t <= area) {
      shorter(ox - (s * cx + t * dx) / area, oy - (s * cy + t * dy) / area, oz - (s * cz + t * dz) / area);
    } else {
      fromSide(ox, oy, oz, cx, cy, cz);
      fromSide(ox, oy, oz, dx, dy, dz);
      fromSide(ox - cx, oy - cy, oz - cz, dx - cx, dy - cy, dz - cz);
    }
  }
}

// Sides that have no length lead nowhere: nothing is shorter than NaN.
@inline function fromSide(ox: f32, oy: f32, oz: f32, x: f32, y: f32, z: f32): void {
  const share = min<f32>(max<f32>((ox * x + oy * y + oz * z) / (x * x + y * y + z * z), 0), 1);
  shorter(ox - share * x, oy - share * y, oz - share * z);
}

@inline function shorter(x: f32, y: f32, z: f32): void {
  if (x * x + y * y + z * z < wx * wx + wy * wy + wz * wz) {
    wx = x; wy = y; wz = z;
  }
}

// The squares of the distances to what is not of the same sheet, most where none is so near, of every lane of the
// clusters; behind them which lane is the nearest.
function rooms(x: usize, count: i32, most: f32, memoryAt: usize): usize {
  const rows = memoryAt, squares = rows + <usize>count * POINT_ROWS, which = squares + <usize>count * ROW;
  const table = which + <usize>count * ROW, found = table + (<usize>count << 2), boxes = (found + (<usize>count << 2) + 15) & ~15;
  const groups = boxes + boxBytes(count);
  const clusters = at(A.CLUSTERS), place = at(A.PLACE), start = at(A.OTHER_START), other = at(A.OTHER), bound = at(A.BOUND);
  for (let c = 0; c < count; c++) {
    const to = rows + c * POINT_ROWS;
    for (let lane = 0; lane < LANES; lane++) {
      const v = whole(place, whole(clusters, LANES * c + lane)), p = to + (<usize>lane << 2);
      store<f32>(p, ax(x, v));
      store<f32>(p, ay(x, v), 64);
      store<f32>(p, az(x, v), 128);
    }
  }
  boxesAround(rows, count, POINT_ROWS, 0, 0, boxes, groups);
  for (let e = 0; e < LANES * count; e += 4) v128.store(squares + (<usize>e << 2), all(most));
  memory.fill(table, 255, <usize>count << 2);
  for (let a = 0; a < count; a++) {
    const end = whole(start, a + 1);
    for (let entry = whole(start, a); entry < end; entry++) store<i32>(table + (<usize>whole(other, entry) << 2), entry);
    const many = findClose(a, count, boxes, groups, most, found);
    for (let n = 0; n < many; n++) {
      const b = whole(found, n), listed = whole(table, b);
      const bounds: usize = listed < 0 ? 0 : bound + (<usize>listed << 8);
      if (mayCount(rows + a * POINT_ROWS, rows + b * POINT_ROWS, bounds, most)) {
        lower(rows, a, b, listed >= 0, squares, which, most);
      }
    }
    for (let entry = whole(start, a); entry < end; entry++) store<i32>(table + (<usize>whole(other, entry) << 2), -1);
  }
  return squares;
}

function mayCount(own: usize, other: usize, bounds: usize, most: f32): bool {
  const far = all(most), step = all(BOUND_M2);
  let some = 0;
  for (let q = 0; q < 4; q++) {
    const p = other + q * QUAD, x = v128.load(p), y = v128.load(p, 64), z = v128.load(p, 128);
    let nearby = far;
    for (let i = 0; i < LANES; i++) {
      const o = own + (<usize>i << 2);
      let d = square(sub(v128.load32_splat(o), x), sub(v128.load32_splat(o, 64), y), sub(v128.load32_splat(o, 128), z));
      if (bounds) {
        const eight = v128.load32_zero(bounds + LANES * i + 4 * q);
        const limit = mul(step, f32x4.convert_i32x4_u(i32x4.extend_low_i16x8_u(i16x8.extend_low_i8x16_u(eight))));
        d = v128.bitselect(d, far, f32x4.lt(d, limit));
      }
      nearby = least(d, nearby);
    }
    v128.store(nearest + q * QUAD, nearby);
    some |= i32x4.bitmask(f32x4.lt(nearby, far));
  }
  return some != 0;
}

function lower(rows: usize, a: i32, b: i32, listed: bool, squares: usize, which: usize, most: f32): void {
  const clusters = at(A.CLUSTERS);
  for (let j = 0; j < LANES; j++) {
    if (!(number(nearest, j) < most)) continue;
    const p = rows + b * POINT_ROWS + (<usize>j << 2), other = squares + (<usize>(LANES * b + j) << 2);
    for (let i = 0; i < LANES; i++) {
      const o = rows + a * POINT_ROWS + (<usize>i << 2), own = squares + (<usize>(LANES * a + i) << 2);
      const x = load<f32>(o) - load<f32>(p), y = load<f32>(o, 64) - load<f32>(p, 64), z = load<f32>(o, 128) - load<f32>(p, 128);
      const far = x * x + y * y + z * z;
      if (!(far < max<f32>(load<f32>(own), load<f32>(other)))) continue;
      if (listed && isNear(whole(clusters, LANES * a + i), whole(clusters, LANES * b + j), far)) continue;
      if (far < load<f32>(own)) {
        store<f32>(own, far);
        store<i32>(which + (<usize>(LANES * a + i) << 2), LANES * b + j);
      }
      if (far < load<f32>(other)) {
        store<f32>(other, far);
        store<i32>(which + (<usize>(LANES * b + j) << 2), LANES * a + i);
      }
    }
  }
}

function isNear(v: i32, u: i32, far: f32): bool {
  const vertex = at(A.NEAR_VERTEX), square = at(A.NEAR_SQUARE), end = whole(at(A.NEAR_START), v + 1);
  for (let entry = whole(at(A.NEAR_START), v); entry < end; entry++) {
    if (whole(vertex, entry) == u && far >= number(square, entry)) return true;
  }
  return false;
}
