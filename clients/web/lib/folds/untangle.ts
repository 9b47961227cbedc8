// What passes through itself is moved apart. A copy of drape/live/untangle.py for browsers.
import * as A from "./arrays";
import { at, reserved } from "./arrays";
import { BOX_ROWS, boxBytes, boxesAround, findClose } from "./clusters";
import {
  LANES, QUAD, ROW, ZERO, add, all, ax, ay, az, det, div, dot, gather, gx, gy, gz, least, mad, most, mul, number, putRows, root, rows as rows3, square, sub, whole,
} from "./vectors";

const STEPS: i32 = 4;
const BORDER: i32 = -1, OTHERS: i32 = -2;
const MOST_PAIRS: i32 = 8192;
const OBLIQUE: f32 = 0.05, SOFT: f32 = 0.25, TOUCH_M2: f32 = 1e-12;
const CONE_RAD: f64 = 0.45 * Math.PI;
const TINY: f32 = 1e-30;

const LOW: i32 = 9 * ROW, HIGH: i32 = 12 * ROW, NORMAL: i32 = 15 * ROW, HEIGHT: i32 = 18 * ROW, ROWS: i32 = 19 * ROW;

const side: usize = memory.data(64, 16), out: usize = memory.data(64, 16);
// Vectors of shorten().
const V: usize = memory.data(16 * 12, 16);
const NN: usize = V, P: usize = V + 12, E: usize = V + 24, ALONG: usize = V + 36, RUN: usize = V + 48, INWARD: usize = V + 60;
const FOUND: usize = V + 72, PASS: usize = V + 84, AB: usize = V + 96, BC: usize = V + 108, CA: usize = V + 120, SPOKE: usize = V + 132;
const TEMP: usize = V + 144;

@inline export function tangleBytes(clusters: i32, places: i32): usize {
  return <usize>clusters * (ROWS + 16 + 8) + boxBytes(clusters) + boxBytes((clusters + LANES - 1) / LANES) +
    <usize>MOST_PAIRS * 8 + <usize>places * 20 + 64;
}

let pairs: usize = 0;

// Moves x where triangles cross, by farthest at most in a step. Where the ways of each place in the last step are counted;
// 0 where nothing crossed.
export function untangle(x: usize, places: i32, farthest: f32, room: usize): usize {
  const count = reserved(A.TANGLE_CORNER) / (3 * LANES), filled = crossing(x, count, room);
  if (filled == 0) return 0;
  const way = (pairs + <usize>MOST_PAIRS * 8 + 15) & ~15, times = way + (<usize>places << 4);
  for (let step = 0; step < STEPS; step++) {
    memory.fill(way, 0, <usize>places * 20);
    for (let n = 0; n < filled; n++) {
      const one = whole(pairs, 2 * n), other = whole(pairs, 2 * n + 1);
      shorten(x, one, other, way, times);
      shorten(x, other, one, way, times);
    }
    for (let v = 0; v < places; v++) {
      const many = number(times, v);
      if (!(many > 0)) continue;
      const to = x + (<usize>v << 4);
      v128.store(to, mad(v128.load(to), all(farthest / many), v128.load(way + (<usize>v << 4))));
    }
  }
  return times;
}

function crossing(x: usize, count: i32, room: usize): i32 {
  const corner = at(A.TANGLE_CORNER), start = at(A.TANGLE_START), beside = at(A.TANGLE_BESIDE);
  const rows = room, cones = rows + <usize>count * ROWS, joined = cones + (<usize>count << 4);
  const close = joined + (<usize>count << 2), boxes = (close + (<usize>count << 2) + 15) & ~15;
  const groups = boxes + boxBytes(count);
  pairs = groups + boxBytes((count + LANES - 1) / LANES);
  for (let c = 0; c < count; c++) lay(x, corner, c, rows);
  boxesAround(rows, count, ROWS, LOW, HIGH, boxes, groups);
  for (let c = 0; c < count; c++) writeCone(rows + c * ROWS + NORMAL, cones + (<usize>c << 4));
  memory.fill(joined, 255, <usize>count << 2);
  let filled = 0;
  for (let a = 0; a < count; a++) {
    const end = whole(start, a + 1);
    for (let entry = whole(start, a); entry < end; entry++) store<i32>(joined + (<usize>whole(beside, entry) << 2), a);
    const many = findClose(a, count, boxes, groups, TOUCH_M2, close), own = rows + a * ROWS;
    for (let n = 0; n < many; n++) {
      const b = whole(close, n), other = rows + b * ROWS;
      if (whole(joined, b) == a && inOneCone(cones + (<usize>a << 4), cones + (<usize>b << 4))) continue;
      writeOutOfBox(own, boxes + BOX_ROWS * (b / LANES) + (<usize>(b % LANES) << 2));
      for (let i = 0; i < LANES; i++) {
        if (number(out, i) > 0) continue;
        if (!writeSides(own, i, other)) continue;
        for (let j = a == b ? i + 1 : 0; j < LANES; j++) {
          if (
            number(side, j) < 0 && filled < MOST_PAIRS && !areJoined(corner, 3 * LANES * a + i, 3 * LANES * b + j) &&
            isParted(own, i, other, j)
          ) {
            store<i32>(pairs + (<usize>filled << 3), LANES * a + i);
            store<i32>(pairs + (<usize>filled << 3), LANES * b + j, 4);
            filled += 1;
          }
        }
      }
    }
  }
  return filled;
}

function lay(x: usize, corner: usize, c: i32, rows: usize): void {
  for (let q = 0; q < 4; q++) {
    const index = corner + 3 * c * ROW + q * QUAD, to = rows + c * ROWS + q * QUAD;
    gather(x, index);
    const px = gx, py = gy, pz = gz;
    gather(x, index + ROW);
    const qx = gx, qy = gy, qz = gz;
    gather(x, index + 2 * ROW);
    const rx = gx, ry = gy, rz = gz;
    putRows(to, px, py, pz);
    putRows(to + 3 * ROW, qx, qy, qz);
    putRows(to + 6 * ROW, rx, ry, rz);
    const ux = sub(qx, px), uy = sub(qy, py), uz = sub(qz, pz), wx = sub(rx, px), wy = sub(ry, py), wz = sub(rz, pz);
    const nx = det(uy, uz, wz, wy), ny = det(uz, ux, wx, wz), nz = det(ux, uy, wy, wx);
    putRows(to + NORMAL, nx, ny, nz);
    v128.store(to + HEIGHT, dot(nx, ny, nz, px, py, pz));
    putRows(to + LOW, least(least(px, qx), rx), least(least(py, qy), ry), least(least(pz, qz), rz));
    putRows(to + HIGH, most(most(px, qx), rx), most(most(py, qy), ry), most(most(pz, qz), rz));
  }
}

@inline function sum(a: v128): f32 {
  return (f32x4.extract_lane(a, 0) + f32x4.extract_lane(a, 1)) + (f32x4.extract_lane(a, 2) + f32x4.extract_lane(a, 3));
}

function writeCone(normals: usize, to: usize): void {
  let x = ZERO, y = ZERO, z = ZERO;
  for (let q = 0; q < 4; q++) {
    rows3(normals + q * QUAD);
    const per = div(all(1), root(most(square(gx, gy, gz), all(TINY))));
    x = mad(x, per, gx); y = mad(y, per, gy); z = mad(z, per, gz);
  }
  const a = sum(x), b = sum(y), c = sum(z), length = max<f32>(Mathf.sqrt(a * a + b * b + c * c), TINY);
  let cosine = all(1);
  for (let q = 0; q < 4; q++) {
    rows3(normals + q * QUAD);
    const per = div(all(1), root(most(square(gx, gy, gz), all(TINY))));
    cosine = least(cosine, div(mul(per, dot(all(a), all(b), all(c), gx, gy, gz)), all(length)));
  }
  const smallest = min<f32>(
    min<f32>(f32x4.extract_lane(cosine, 0), f32x4.extract_lane(cosine, 1)),
    min<f32>(f32x4.extract_lane(cosine, 2), f32x4.extract_lane(cosine, 3)),
  );
  store<f32>(to, a / length);
  store<f32>(to, b / length, 4);
  store<f32>(to, c / length, 8);
  store<f32>(to, <f32>Math.acos(<f64>max<f32>(smallest, -1)), 12);
}

function inOneCone(a: usize, b: usize): bool {
  const cosine = load<f32>(a) * load<f32>(b) + load<f32>(a, 4) * load<f32>(b, 4) + load<f32>(a, 8) * load<f32>(b, 8);
  const between = Math.acos(<f64>min<f32>(max<f32>(cosine, -1), 1));
  return 0.5 * between + <f64>max<f32>(load<f32>(a, 12), load<f32>(b, 12)) < CONE_RAD;
}

function writeOutOfBox(own: usize, box: usize): void {
  for (let q = 0; q < 4; q++) {
    const low = own + LOW + q * QUAD, high = own + HIGH + q * QUAD;
    const x = most(sub(v128.load(low), v128.load32_splat(box + 3 * ROW)), sub(v128.load32_splat(box), v128.load(high)));
    const y = most(sub(v128.load(low, 64), v128.load32_splat(box + 4 * ROW)), sub(v128.load32_splat(box + ROW), v128.load(high, 64)));
    const z = most(sub(v128.load(low, 128), v128.load32_splat(box + 5 * ROW)), sub(v128.load32_splat(box + 2 * ROW), v128.load(high, 128)));
    v128.store(out + q * QUAD, most(most(x, y), z));
  }
}

// Whether a triangle of the other cluster has corners on both sides of the plane of triangle i, and a box that overlaps.
function writeSides(own: usize, i: i32, other: usize): bool {
  const lane = <usize>i << 2, normal = own + NORMAL + lane;
  const nx = v128.load32_splat(normal), ny = v128.load32_splat(normal, 64), nz = v128.load32_splat(normal, 128);
  const height = v128.load32_splat(own + HEIGHT + lane), low = own + LOW + lane, high = own + HIGH + lane;
  let some = 0;
  for (let q = 0; q < 4; q++) {
    const p = other + q * QUAD;
    rows3(p);
    const a = dot(nx, ny, nz, gx, gy, gz);
    rows3(p + 3 * ROW);
    const b = dot(nx, ny, nz, gx, gy, gz);
    rows3(p + 6 * ROW);
    const c = dot(nx, ny, nz, gx, gy, gz);
    const apart = most(sub(least(least(a, b), c), height), sub(height, most(most(a, b), c)));
    const x = most(sub(v128.load(p + LOW), v128.load32_splat(high)), sub(v128.load32_splat(low), v128.load(p + HIGH)));
    const y = most(sub(v128.load(p + LOW + ROW), v128.load32_splat(high, 64)), sub(v128.load32_splat(low, 64), v128.load(p + HIGH + ROW)));
    const z = most(sub(v128.load(p + LOW + 2 * ROW), v128.load32_splat(high, 128)), sub(v128.load32_splat(low, 128), v128.load(p + HIGH + 2 * ROW)));
    const found = most(apart, most(most(x, y), z));
    v128.store(side + q * QUAD, found);
    some |= i32x4.bitmask(f32x4.lt(found, ZERO));
  }
  return some != 0;
}

// Whether the plane of triangle j has corners of triangle i on both sides.
function isParted(own: usize, i: i32, other: usize, j: i32): bool {
  const p = other + (<usize>j << 2), o = own + (<usize>i << 2);
  const nx = load<f32>(p + NORMAL), ny = load<f32>(p + NORMAL + ROW), nz = load<f32>(p + NORMAL + 2 * ROW);
  let lowest: f32 = 0, highest: f32 = 0;
  for (let k = 0; k < 3; k++) {
    const c = o + 3 * k * ROW;
    const d = nx * (load<f32>(c) - load<f32>(p)) + ny * (load<f32>(c, 64) - load<f32>(p, 64)) + nz * (load<f32>(c, 128) - load<f32>(p, 128));
    if (k == 0 || d < lowest) lowest = d;
    if (k == 0 || d > highest) highest = d;
  }
  return lowest < 0 && highest > 0;
}

function areJoined(corner: usize, first: i32, second: i32): bool {
  for (let n = 0; n < 3; n++) {
    for (let m = 0; m < 3; m++) {
      if (whole(corner, first + LANES * n) == whole(corner, second + LANES * m)) return true;
    }
  }
  return false;
}

@inline function get(p: usize, i: i32): f32 { return load<f32>(p + (<usize>i << 2)); }
@inline function set(p: usize, x: f32, y: f32, z: f32): void { store<f32>(p, x); store<f32>(p, y, 4); store<f32>(p, z, 8); }
function dot3(a: usize, b: usize): f32 { return get(a, 0) * get(b, 0) + get(a, 1) * get(b, 1) + get(a, 2) * get(b, 2); }
function cross3(to: usize, a: usize, b: usize): void {
  set(to, get(a, 1) * get(b, 2) - get(a, 2) * get(b, 1), get(a, 2) * get(b, 0) - get(a, 0) * get(b, 2), get(a, 0) * get(b, 1) - get(a, 1) * get(b, 0));
}
@inline function between(to: usize, x: usize, v: i32, u: i32): void {
  set(to, ax(x, v) - ax(x, u), ay(x, v) - ay(x, u), az(x, v) - az(x, u));
}

// Adds the ways of the edges of the triangle edged that pass through the triangle through.
function shorten(x: usize, edged: i32, through: i32, way: usize, times: usize): void {
  const corner = at(A.TANGLE_CORNER), across = at(A.TANGLE_ACROSS);
  const first = 3 * LANES * (edged / LANES) + edged % LANES, other = 3 * LANES * (through / LANES) + through % LANES;
  const a = whole(corner, other), b = whole(corner, other + LANES), c = whole(corner, other + 2 * LANES);
  between(AB, x, b, a);
  between(TEMP, x, c, a);
  cross3(NN, AB, TEMP);
  const size = Mathf.sqrt(dot3(NN, NN));
  if (!(size > 0)) return;
  set(NN, get(NN, 0) / size, get(NN, 1) / size, get(NN, 2) / size);
  between(BC, x, c, b);
  between(CA, x, a, c);
  for (let n = 0; n < 3; n++) {
    const beyond = whole(across, first + LANES * n);
    if (beyond == OTHERS) continue;
    const p = whole(corner, first + LANES * n), q = whole(corner, first + LANES * ((n + 1) % 3)), r = whole(corner, first + LANES * ((n + 2) % 3));
    between(TEMP, x, p, a);
    const below = dot3(NN, TEMP);
    between(TEMP, x, q, a);
    const above = dot3(NN, TEMP);
    if (!(below * above < 0)) continue;
    between(E, x, q, p);
    const share = below / (below - above);
    set(PASS, ax(x, p) + share * get(E, 0), ay(x, p) + share * get(E, 1), az(x, p) + share * get(E, 2));
    if (min<f32>(turn(x, a, AB), min<f32>(turn(x, b, BC), turn(x, c, CA))) < 0) continue;
    const long = Mathf.sqrt(dot3(E, E));
    set(ALONG, get(E, 0) / long, get(E, 1) / long, get(E, 2) / long);
    between(INWARD, x, r, p);
    run(false);
    if (beyond != BORDER) {
      between(INWARD, x, beyond, p);
      run(true);
    }
    let steep = dot3(ALONG, NN);
    steep = steep > 0 ? max<f32>(steep, OBLIQUE) : min<f32>(steep, -OBLIQUE);
    const by: f32 = -2 * dot3(ALONG, RUN) / steep;
    set(RUN, get(RUN, 0) + by * get(NN, 0), get(RUN, 1) + by * get(NN, 1), get(RUN, 2) + by * get(NN, 2));
    const per: f32 = 1 / Mathf.sqrt(dot3(RUN, RUN) + SOFT);
    set(RUN, per * get(RUN, 0), per * get(RUN, 1), per * get(RUN, 2));
    go(way, times, p, 1);
    go(way, times, q, 1);
    go(way, times, a, -1);
    go(way, times, b, -1);
    go(way, times, c, -1);
  }
}

// On which side of the edge that begins at v the edge passes.
function turn(x: usize, v: i32, edge: usize): f32 {
  set(SPOKE, get(PASS, 0) - ax(x, v), get(PASS, 1) - ay(x, v), get(PASS, 2) - az(x, v));
  cross3(TEMP, edge, SPOKE);
  return dot3(TEMP, NN);
}

// The unit vector, in the triangle that lies inward of an edge, along the plane; more: added to RUN.
function run(more: bool): void {
  cross3(TEMP, ALONG, INWARD);
  cross3(FOUND, NN, TEMP);
  let length = Mathf.sqrt(dot3(FOUND, FOUND));
  if (length > 0) {
    const along = dot3(INWARD, ALONG);
    set(TEMP, get(INWARD, 0) - along * get(ALONG, 0), get(INWARD, 1) - along * get(ALONG, 1), get(INWARD, 2) - along * get(ALONG, 2));
    if (!(dot3(FOUND, TEMP) > 0)) length = -length;
    set(FOUND, get(FOUND, 0) / length, get(FOUND, 1) / length, get(FOUND, 2) / length);
  }
  if (more) set(RUN, get(RUN, 0) + get(FOUND, 0), get(RUN, 1) + get(FOUND, 1), get(RUN, 2) + get(FOUND, 2));
  else set(RUN, get(FOUND, 0), get(FOUND, 1), get(FOUND, 2));
}

function go(way: usize, times: usize, v: i32, sign: f32): void {
  const to = way + (<usize>v << 4), count = times + (<usize>v << 2);
  for (let i = 0; i < 3; i++) store<f32>(to + (<usize>i << 2), load<f32>(to + (<usize>i << 2)) + sign * get(RUN, i));
  store<f32>(count, load<f32>(count) + 1);
}
