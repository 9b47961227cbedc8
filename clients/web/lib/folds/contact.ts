// Contact with the posed skin. A copy of drape/live/skin_contact.py and skin_walks.py for browsers.
import * as A from "./arrays";
import { at, constant, reserved } from "./arrays";
import { HELD_ROW, OTHER_PLANE, PLANES, SLIP_M } from "./sweeps";
import {
  ONE, QUAD, ROW, ZERO, above, add, all, ax, ay, az, det, div, dot, gw, gx, gy, gz, least, mad, most, mul, number, points, putPoints, putRows, root, rows, square, sub, turned, whole,
} from "./vectors";

export const SAMPLE: i32 = 32; // bytes of a sample of the skin: point, square, normal, normal times point
const NEIGHBOURS: i32 = 8;
const STEPS: i32 = 3;
const REACH_M: f64 = 0.03;
const PER_CELL: f64 = 1 / (2 * 0.03);
const TURNS: i32 = 4;
const NEARER: f64 = 0.8;
const BESIDE: f64 = 1.5, FREE: f64 = 2.5;
const HOLLOW_M: f64 = 0.05, APART_M: f64 = 0.12;
const WIDEST_M: f64 = 10;

const near: usize = memory.data(4 * 16, 16); // four whole numbers
const own: usize = memory.data(16, 16);
const lateVertex: usize = memory.data(16, 16), lateSample: usize = memory.data(16, 16);
const perM2: usize = memory.data(16, 16);
const lateRows: usize = memory.data(6 * 64, 16);

@inline function sample(skin: usize, s: i32): usize { return skin + ((<usize>s) << 5); }

@inline function squared(x: f32, y: f32, z: f32, skin: usize, s: i32): f32 {
  const p = sample(skin, s);
  const a = x - load<f32>(p), b = y - load<f32>(p, 4), c = z - load<f32>(p, 8);
  return a * a + b * b + c * c;
}

// Where a walk from a sample ends, always on to the nearest neighbour, of so many steps at most.
function nearest(x: f32, y: f32, z: f32, skin: usize, from: i32, steps: i32): i32 {
  let found = from, least = squared(x, y, z, skin, from);
  const neighbour = at(A.NEIGHBOUR);
  for (let step = 0; step < steps; step++) {
    const here = found, list = neighbour + ((<usize>here) << 5);
    for (let n = 0; n < NEIGHBOURS; n++) {
      const s = whole(list, n), square = squared(x, y, z, skin, s);
      if (square < least) { least = square; found = s; }
    }
    if (found == here) break;
  }
  return found;
}

export function follow(network: usize, places: i32, skin: usize, touched: usize): void {
  const most = reserved(A.REACH_M2);
  for (let v = 0; v < places; v++) {
    const to = touched + (<usize>v << 2);
    store<i32>(to, nearest(ax(network, v), ay(network, v), az(network, v), skin, load<i32>(to), most));
  }
}

@inline function samples(skin: usize, index: usize, part: usize): void {
  turned(
    v128.load(sample(skin, whole(index, 0)) + part), v128.load(sample(skin, whole(index, 1)) + part),
    v128.load(sample(skin, whole(index, 2)) + part), v128.load(sample(skin, whole(index, 3)) + part),
  );
}

// The frame of a quad's own samples: place, normal, edge and their product.
let fx: v128 = f32x4.splat(0), fy: v128 = f32x4.splat(0), fz: v128 = f32x4.splat(0);
let nx: v128 = f32x4.splat(0), ny: v128 = f32x4.splat(0), nz: v128 = f32x4.splat(0);
let ex: v128 = f32x4.splat(0), ey: v128 = f32x4.splat(0), ez: v128 = f32x4.splat(0);

function skinFrame(skin: usize, index: usize): void {
  const neighbour = at(A.NEIGHBOUR);
  for (let lane = 0; lane < 4; lane++) store<i32>(near + (<usize>lane << 2), whole(neighbour, whole(index, lane) << 3));
  samples(skin, index, 0);
  fx = gx; fy = gy; fz = gz;
  samples(skin, index, 16);
  nx = gx; ny = gy; nz = gz;
  samples(skin, near, 0);
  const wx = sub(gx, fx), wy = sub(gy, fy), wz = sub(gz, fz), along = dot(wx, wy, wz, nx, ny, nz);
  ex = sub(wx, mul(along, nx)); ey = sub(wy, mul(along, ny)); ez = sub(wz, mul(along, nz));
  const long = square(ex, ey, ez), per = div(ONE, root(above(long, ZERO, long, ONE)));
  ex = mul(per, ex); ey = mul(per, ey); ez = mul(per, ez);
}

// Where the posed skin has taken what sticks to it.
export function stuckPlaces(grip: usize, touched: usize, places: i32, skin: usize, stuck: usize): void {
  for (let v = 0; v < places; v += 4) {
    skinFrame(skin, touched + (<usize>v << 2));
    points(grip + (<usize>v << 4));
    const a = gx, b = gy, c = gz;
    const px = det(ny, nz, ez, ey), py = det(nz, nx, ex, ez), pz = det(nx, ny, ey, ex);
    putPoints(
      stuck + (<usize>v << 4), add(fx, mad(mad(mul(a, nx), b, ex), c, px)), add(fy, mad(mad(mul(a, ny), b, ey), c, py)),
      add(fz, mad(mad(mul(a, nz), b, ez), c, pz)),
    );
  }
}

// The places of what sticks, which come along below x, in the frames of its samples.
export function writeGrip(x: usize, stuck: usize, touched: usize, places: i32, skin: usize, grip: usize): void {
  const slack = all(SLIP_M);
  for (let v = 0; v < places; v += 4) {
    skinFrame(skin, touched + (<usize>v << 2));
    points(x + (<usize>v << 4));
    const ox = gx, oy = gy, oz = gz;
    points(stuck + (<usize>v << 4));
    let sx = sub(ox, gx), sy = sub(oy, gy), sz = sub(oz, gz);
    const along = dot(sx, sy, sz, nx, ny, nz);
    sx = sub(sx, mul(along, nx)); sy = sub(sy, mul(along, ny)); sz = sub(sz, mul(along, nz));
    const length = root(most(square(sx, sy, sz), mul(slack, slack)));
    const share = above(length, slack, div(slack, length), ONE);
    const wx = sub(sub(ox, mul(share, sx)), fx), wy = sub(sub(oy, mul(share, sy)), fy), wz = sub(sub(oz, mul(share, sz)), fz);
    const px = det(ny, nz, ez, ey), py = det(nz, nx, ex, ez), pz = det(nx, ny, ey, ex);
    putPoints(
      grip + (<usize>v << 4), dot(nx, ny, nz, wx, wy, wz), dot(ex, ey, ez, wx, wy, wz), dot(px, py, pz, wx, wy, wz),
    );
  }
}

// Writes foot and normal of the planes below four points, of four samples and their neighbours; ROW between the rows.
function plane(x: v128, y: v128, z: v128, index: usize, skin: usize, to: usize): void {
  const neighbour = at(A.NEIGHBOUR), reach = at(A.REACH_M2);
  for (let lane = 0; lane < 4; lane++) store<f32>(perM2 + (<usize>lane << 2), number(reach, whole(index, lane)));
  const per = div(ONE, v128.load(perM2)), self = v128.load(index);
  samples(skin, index, 0);
  let px = gx, py = gy, pz = gz;
  const ownSquare = square(sub(gx, x), sub(gy, y), sub(gz, z));
  samples(skin, index, 16);
  let mx = gx, my = gy, mz = gz, product = gw, total = ONE;
  const height = sub(dot(gx, gy, gz, x, y, z), gw), aside = mul(sub(ownSquare, mul(height, height)), per);
  for (let n = 0; n < NEIGHBOURS; n++) {
    for (let lane = 0; lane < 4; lane++) {
      store<i32>(near + (<usize>lane << 2), whole(neighbour, (whole(index, lane) << 3) + n));
    }
    samples(skin, near, 0);
    const ax = gx, ay = gy, az = gz;
    samples(skin, near, 16);
    let share = most(sub(ONE, mul(sub(square(sub(ax, x), sub(ay, y), sub(az, z)), ownSquare), per)), ZERO);
    share = least(share, ONE);
    const weight = v128.and(mul(share, share), i32x4.ne(v128.load(near), self)); // a sample may be its own neighbour
    total = add(total, weight);
    product = mad(product, weight, gw);
    px = mad(px, weight, ax); py = mad(py, weight, ay); pz = mad(pz, weight, az);
    mx = mad(mx, weight, gx); my = mad(my, weight, gy); mz = mad(mz, weight, gz);
  }
  const share = div(ONE, total), long = square(mx, my, mz);
  const unit = div(ONE, root(above(long, ZERO, long, ONE)));
  const ux = mul(unit, mx), uy = mul(unit, my), uz = mul(unit, mz);
  const bySamples = mul(sub(dot(x, y, z, mx, my, mz), product), share);
  const byBlend = dot(ux, uy, uz, sub(x, mul(share, px)), sub(y, mul(share, py)), sub(z, mul(share, pz)));
  const beside = least(most(mul(sub(aside, all(<f32>BESIDE)), all(<f32>(1 / (FREE - BESIDE)))), ZERO), ONE);
  const far = add(mul(mul(sub(ONE, beside), all(0.5)), add(bySamples, byBlend)), mul(beside, all(<f32>REACH_M)));
  putRows(to, sub(x, mul(far, ux)), sub(y, mul(far, uy)), sub(z, mul(far, uz)));
  putRows(to + 3 * ROW, ux, uy, uz);
}

// Moves touched other samples on to what is near x, and writes both planes.
export function touch(
  x: usize, places: i32, skin: usize, touched: usize, others: usize, turn: i32, planes: usize, grid: usize,
): void {
  const count = reserved(A.REACH_M2), vertex = at(A.VERTEX);
  makeGrid(skin, count, grid);
  let waiting = 0;
  for (let first = 0; first < places; first += 4) {
    const place = planes + (first >> 4) * PLANES + ((first >> 2) & 3) * QUAD;
    for (let lane = 0; lane < 4; lane++) {
      const v = first + lane;
      store<i32>(own + (<usize>lane << 2), nearest(ax(x, v), ay(x, v), az(x, v), skin, whole(touched, v), STEPS));
    }
    points(x + (<usize>first << 4));
    plane(gx, gy, gz, own, skin, place);
    for (let row = OTHER_PLANE; row < HELD_ROW; row += ROW) v128.store(place + row, ZERO);
    for (let lane = 0; lane < 4; lane++) {
      const v = first + lane, a = ax(x, v), b = ay(x, v), c = az(x, v), self = whole(own, lane);
      let other = whole(others, v);
      if (turn < 0 || whole(vertex, v) % TURNS == turn) {
        other = nearSamples(a, b, c, skin, self);
        if (same != self) store<i32>(touched + (<usize>v << 2), same);
      } else if (other >= 0) {
        other = nearest(a, b, c, skin, other, STEPS);
        if (<f64>squared(a, b, c, skin, other) >= REACH_M * REACH_M || !isOther(skin, self, other)) other = -1;
      }
      store<i32>(others + (<usize>v << 2), other);
      if (other < 0) continue;
      store<i32>(lateVertex + (<usize>waiting << 2), v);
      store<i32>(lateSample + (<usize>waiting << 2), other);
      waiting += 1;
      if (waiting == 4) {
        putLate(x, skin, planes, 4);
        waiting = 0;
      }
    }
  }
  if (waiting > 0) {
    for (let lane = waiting; lane < 4; lane++) {
      store<i32>(lateVertex + (<usize>lane << 2), load<i32>(lateVertex));
      store<i32>(lateSample + (<usize>lane << 2), load<i32>(lateSample));
    }
    putLate(x, skin, planes, waiting);
  }
}

function putLate(x: usize, skin: usize, planes: usize, count: i32): void {
  turned(
    v128.load(x + (<usize>whole(lateVertex, 0) << 4)), v128.load(x + (<usize>whole(lateVertex, 1) << 4)),
    v128.load(x + (<usize>whole(lateVertex, 2) << 4)), v128.load(x + (<usize>whole(lateVertex, 3) << 4)),
  );
  plane(gx, gy, gz, lateSample, skin, lateRows);
  for (let lane = 0; lane < count; lane++) {
    const v = whole(lateVertex, lane);
    const to = planes + (v >> 4) * PLANES + OTHER_PLANE + (<usize>(v & 15) << 2);
    for (let row = 0; row < 6; row++) store<f32>(to + row * ROW, load<f32>(lateRows + row * ROW + (<usize>lane << 2)));
  }
}

function isOther(skin: usize, self: i32, s: i32): bool {
  const rest = at(A.REST);
  const a = number(rest, 3 * s) - number(rest, 3 * self), b = number(rest, 3 * s + 1) - number(rest, 3 * self + 1);
  const c = number(rest, 3 * s + 2) - number(rest, 3 * self + 2);
  const apart = <f64>(a * a + b * b + c * c);
  if (apart > APART_M * APART_M) return true;
  if (!(apart > HOLLOW_M * HOLLOW_M)) return false;
  const here = sample(skin, self), there = sample(skin, s);
  const rise = load<f32>(here, 16) * (load<f32>(there) - load<f32>(here)) +
    load<f32>(here, 20) * (load<f32>(there, 4) - load<f32>(here, 4)) +
    load<f32>(here, 24) * (load<f32>(there, 8) - load<f32>(here, 8));
  return rise > 0;
}

// --- the grid of samples: drape/kernels/grid.py ----------------------------------------------------------------------

let lowX: f64 = 0, lowY: f64 = 0, lowZ: f64 = 0;
let countX: i32 = 0, countY: i32 = 0, countZ: i32 = 0;
let cellStart: usize = 0, cellMember: usize = 0;
export const MOST_CELLS: i32 = 1 << 17;

@inline function cellOf(value: f32, low: f64): i32 { return <i32>((<f64>value - low) * PER_CELL); }

function makeGrid(skin: usize, count: i32, room: usize): void {
  let low: v128 = v128.load(skin), high: v128 = low;
  for (let s = 1; s < count; s++) {
    const p = v128.load(sample(skin, s));
    low = f32x4.min(low, p); // NaN stays
    high = f32x4.max(high, p);
  }
  lowX = <f64>f32x4.extract_lane(low, 0); lowY = <f64>f32x4.extract_lane(low, 1); lowZ = <f64>f32x4.extract_lane(low, 2);
  countX = cells(<f64>f32x4.extract_lane(high, 0) - lowX);
  countY = cells(<f64>f32x4.extract_lane(high, 1) - lowY);
  countZ = cells(<f64>f32x4.extract_lane(high, 2) - lowZ);
  const total = countX * countY * countZ;
  if (total > MOST_CELLS) { countX = 0; return; }
  cellStart = room;
  cellMember = room + (<usize>(MOST_CELLS + 1) << 2);
  const cell = cellMember + (<usize>count << 2);
  if (total == 0) return;
  memory.fill(cellStart, 0, <usize>total << 2);
  for (let s = 0; s < count; s++) {
    const p = sample(skin, s);
    const c = (cellOf(load<f32>(p), lowX) * countY + cellOf(load<f32>(p, 4), lowY)) * countZ + cellOf(load<f32>(p, 8), lowZ);
    store<i32>(cell + (<usize>s << 2), c);
    const to = cellStart + (<usize>c << 2);
    store<i32>(to, load<i32>(to) + 1);
  }
  for (let c = 1; c < total; c++) {
    const to = cellStart + (<usize>c << 2);
    store<i32>(to, load<i32>(to) + whole(cellStart, c - 1));
  }
  store<i32>(cellStart + (<usize>total << 2), count);
  // From the last sample back: ends become starts, and members keep their order.
  for (let s = count - 1; s >= 0; s--) {
    const end = cellStart + (<usize>whole(cell, s) << 2), i = load<i32>(end) - 1;
    store<i32>(end, i);
    store<i32>(cellMember + (<usize>i << 2), s);
  }
}

@inline function cells(extent: f64): i32 { return extent < WIDEST_M ? <i32>(extent * PER_CELL) + 1 : 0; }
@inline function firstCell(value: f64, low: f64, count: i32): i32 {
  return min<i32>(max<i32>(<i32>Math.floor((value - REACH_M - low) * PER_CELL), 0), count);
}
@inline function lastCell(value: f64, low: f64, count: i32): i32 {
  return min<i32>(<i32>Math.floor((value + REACH_M - low) * PER_CELL) + 1, count);
}

let same: i32 = 0; // the nearest sample of the same part, the own one unless another is nearer

// The nearest sample of another part within reach, -1 where there is none; writes the same part's.
function nearSamples(x: f32, y: f32, z: f32, skin: usize, self: i32): i32 {
  same = self;
  if (countX == 0 || countY == 0 || countZ == 0) return -1;
  let found = -1, least: f64 = REACH_M * REACH_M;
  let beside = min<f64>(NEARER * <f64>squared(x, y, z, skin, self), least);
  const i1 = lastCell(<f64>x, lowX, countX), j1 = lastCell(<f64>y, lowY, countY);
  const k0 = firstCell(<f64>z, lowZ, countZ), k1 = lastCell(<f64>z, lowZ, countZ);
  const j0 = firstCell(<f64>y, lowY, countY);
  for (let i = firstCell(<f64>x, lowX, countX); i < i1; i++) {
    for (let j = j0; j < j1; j++) {
      const row = (i * countY + j) * countZ;
      const end = whole(cellStart, row + max<i32>(k1, k0));
      for (let entry = whole(cellStart, row + k0); entry < end; entry++) {
        const s = whole(cellMember, entry), square = <f64>squared(x, y, z, skin, s);
        if (!(square < max<f64>(least, beside))) continue;
        if (isOther(skin, self, s)) {
          if (square < least) { found = s; least = square; }
        } else if (square < beside) {
          same = s;
          beside = square;
        }
      }
    }
  }
  return found;
}
