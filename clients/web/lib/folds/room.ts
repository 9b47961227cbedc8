// The room that the network leaves between sheets. A copy of drape/live/room.py for browsers.
import * as A from "./arrays";
import { at, constant, reserved } from "./arrays";
import { POINT_ROWS, boxBytes, boxesAround, findClose } from "./clusters";
import { HELD_ROW, PLANES, SLACK_ROW } from "./sweeps";
import { LANES, QUAD, ROW, all, ax, ay, az, least, mul, number, square, sub, whole } from "./vectors";

const ROOM_M: f32 = 0.018, TIGHT_M: f64 = 0.012;
const LEAST_M: f32 = 0.0002;
const HELD: f32 = 1.5, STIFFEST: f32 = 4;
const FREE: f64 = 255;
const BOUND_M2: f32 = <f32>(0.018 * 0.018 / (FREE - 1));

const nearest: usize = memory.data(64, 16);

@inline export function roomBytes(clusters: i32): usize {
  return <usize>clusters * (POINT_ROWS + ROW + 8) + boxBytes(clusters) + boxBytes((clusters + LANES - 1) / LANES) + 64;
}

// Tightens the leash in planes where the network's drape comes near to itself.
export function holdWithin(network: usize, planes: usize, room: usize): void {
  const count = reserved(A.CLUSTERS) / LANES, square = rooms(network, count, room);
  const clusters = at(A.CLUSTERS), place = at(A.PLACE), own = at(A.OWN), slack = constant(A.SLACK);
  const far: f32 = ROOM_M * ROOM_M;
  for (let e = 0; e < LANES * count; e++) {
    // Lanes that repeat a vertex come after its own: each vertex is held once.
    if (e % LANES > 0 && whole(clusters, e) == whole(clusters, e - 1)) continue;
    const found = number(square, e), d: f32 = found < far ? Mathf.sqrt(found) : ROOM_M;
    const tight: f32 = (ROOM_M - d) / <f32>(0.018 - TIGHT_M);
    if (!(tight > 0)) continue;
    const v = whole(place, whole(clusters, e)), block = v / LANES, lane = <usize>(v % LANES) << 2;
    const contact = load<f32>(own + (4 * block + 2) * ROW + lane);
    const stiff = min<f32>(ROOM_M / max<f32>(d, LEAST_M) - 1, STIFFEST);
    const to = planes + block * PLANES + lane;
    store<f32>(to + HELD_ROW, load<f32>(to + HELD_ROW) + HELD * stiff * contact);
    store<f32>(to + SLACK_ROW, load<f32>(to + SLACK_ROW) + min<f32>(tight, 1) * (LEAST_M - slack));
  }
}

// The squares of the distances to what is not of the same sheet, of every lane of the clusters.
function rooms(network: usize, count: i32, memoryAt: usize): usize {
  const rows = memoryAt, squares = rows + <usize>count * POINT_ROWS, table = squares + <usize>count * ROW;
  const found = table + (<usize>count << 2), boxes = (found + (<usize>count << 2) + 15) & ~15;
  const groups = boxes + boxBytes(count);
  const clusters = at(A.CLUSTERS), place = at(A.PLACE), start = at(A.OTHER_START), other = at(A.OTHER), bound = at(A.BOUND);
  for (let c = 0; c < count; c++) {
    const to = rows + c * POINT_ROWS;
    for (let lane = 0; lane < LANES; lane++) {
      const v = whole(place, whole(clusters, LANES * c + lane)), p = to + (<usize>lane << 2);
      store<f32>(p, ax(network, v));
      store<f32>(p, ay(network, v), 64);
      store<f32>(p, az(network, v), 128);
    }
  }
  boxesAround(rows, count, POINT_ROWS, 0, 0, boxes, groups);
  const most: f32 = ROOM_M * ROOM_M;
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
        lower(rows, a, b, listed >= 0, squares, most);
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

function lower(rows: usize, a: i32, b: i32, listed: bool, squares: usize, most: f32): void {
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
      store<f32>(own, min<f32>(load<f32>(own), far));
      store<f32>(other, min<f32>(load<f32>(other), far));
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
