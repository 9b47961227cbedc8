// Gradients, and sweeps of vertex block descent. A copy of drape/live/sweeps.py for browsers.
import * as A from "./arrays";
import { at, constant } from "./arrays";
import { addCreases, HESSIAN } from "./creases";
import {
  LANES, QUAD, ROW, ZERO, above, add, all, det, div, dot, gather, gx, gy, gz, mad, most, mul, number, points, putPoints, putRows, root, rows, square, sub, whole,
} from "./vectors";

// Rows of a block of planes, in bytes; PLANES: of the whole block.
export const OTHER_PLANE: i32 = 6 * ROW;
export const HELD_ROW: i32 = 12 * ROW;
export const SLACK_ROW: i32 = 13 * ROW;
export const STUCK: i32 = 14 * ROW;
export const FRICTION_ROW: i32 = 17 * ROW;
export const PLANES: i32 = 18 * ROW;
export const SLIP_M: f32 = 1e-3;
const HOLD: f32 = 0.4;

const scratch: usize = memory.data(9 * 64, 16);

// The result of model(): a gradient and the six numbers of a symmetric matrix.
let g0: v128 = f32x4.splat(0), g1: v128 = f32x4.splat(0), g2: v128 = f32x4.splat(0);
let h0: v128 = f32x4.splat(0), h1: v128 = f32x4.splat(0), h2: v128 = f32x4.splat(0);
let h3: v128 = f32x4.splat(0), h4: v128 = f32x4.splat(0), h5: v128 = f32x4.splat(0);

export function leash(blocks: i32, planes: usize): void {
  const own = at(A.OWN), slack = all(constant(A.SLACK));
  for (let b = 0; b < blocks; b++) {
    for (let q = 0; q < 4; q++) {
      const to = planes + b * PLANES + q * QUAD;
      v128.store(to + HELD_ROW, v128.load(own + (4 * b + 3) * ROW + q * QUAD));
      v128.store(to + SLACK_ROW, slack);
    }
  }
}

export function stick(blocks: i32, stuck: usize, friction: f32, planes: usize): void {
  const own = at(A.OWN), mu = all(friction);
  for (let b = 0; b < blocks; b++) {
    for (let q = 0; q < 4; q++) {
      const to = planes + b * PLANES + q * QUAD;
      points(stuck + (b * 4 + q) * 64);
      putRows(to + STUCK, gx, gy, gz);
      v128.store(to + FRICTION_ROW, mul(mu, v128.load(own + (4 * b + 2) * ROW + q * QUAD)));
    }
  }
}

export function descend(x: usize, blocks: i32, planes: usize, network: usize): void {
  const reach = all(constant(A.REACH)), reach2 = mul(reach, reach);
  for (let b = 0; b < blocks; b++) {
    for (let q = 0; q < 4; q++) {
      model(x, b, q, planes, network, true);
      const a = det(h3, h4, h5, h4), c = det(h2, h1, h4, h5), d = det(h1, h2, h4, h3);
      const e = det(h0, h2, h5, h2), f = det(h1, h0, h2, h4), k = det(h0, h1, h3, h1);
      const per = dot(h0, h1, h2, a, c, d);
      const sx = div(dot(a, c, d, g0, g1, g2), per), sy = div(dot(c, e, f, g0, g1, g2), per);
      const sz = div(dot(d, f, k, g0, g1, g2), per);
      const share = div(reach, root(most(square(sx, sy, sz), reach2)));
      const place = x + (4 * b + q) * 64;
      points(place);
      putPoints(place, sub(gx, mul(share, sx)), sub(gy, mul(share, sy)), sub(gz, mul(share, sz)));
    }
  }
}

export function gradientAt(x: usize, blocks: i32, planes: usize, network: usize, gradient: usize): void {
  for (let b = 0; b < blocks; b++) {
    for (let q = 0; q < 4; q++) {
      model(x, b, q, planes, network, false);
      putPoints(gradient + (4 * b + q) * 64, g0, g1, g2);
    }
  }
}

@inline function model(x: usize, b: i32, q: i32, planes: usize, network: usize, curvature: bool): void {
  const off = q * QUAD;
  points(x + (4 * b + q) * 64);
  const ox = gx, oy = gy, oz = gz;
  outside(ox, oy, oz, b, off, planes + b * PLANES + off, network + (4 * b + q) * 64, curvature);
  const fan = at(A.FAN_OTHER) + off, slope = at(A.FAN_SLOPE) + off;
  const warp = all(constant(A.WARP)), cross = all(constant(A.CROSS)), weft = all(constant(A.WEFT));
  const shear = all(constant(A.SHEAR)), one = all(1);
  const end = whole(at(A.FAN_START), b + 1);
  for (let row = whole(at(A.FAN_START), b); row < end; row++) {
    gather(x, fan + 2 * row * ROW);
    const ex = sub(gx, ox), ey = sub(gy, oy), ez = sub(gz, oz);
    gather(x, fan + (2 * row + 1) * ROW);
    const fx = sub(gx, ox), fy = sub(gy, oy), fz = sub(gz, oz);
    const entry = slope + 5 * row * ROW;
    const p1 = v128.load(entry), t1 = v128.load(entry, 64), p2 = v128.load(entry, 128), t2 = v128.load(entry, 192);
    const area = v128.load(entry, 256);
    const px = add(mul(p1, ex), mul(p2, fx)), py = add(mul(p1, ey), mul(p2, fy)), pz = add(mul(p1, ez), mul(p2, fz));
    const tx = add(mul(t1, ex), mul(t2, fx)), ty = add(mul(t1, ey), mul(t2, fy)), tz = add(mul(t1, ez), mul(t2, fz));
    const mp = sub(f32x4.neg(p1), p2), mt = sub(f32x4.neg(t1), t2);
    const pp = sub(square(px, py, pz), one), tt = sub(square(tx, ty, tz), one), pt = dot(px, py, pz, tx, ty, tz);
    const spp = mul(area, add(mul(warp, pp), mul(cross, tt))), stt = mul(area, add(mul(cross, pp), mul(weft, tt)));
    const spt = mul(mul(area, shear), pt);
    const cp = add(mul(mp, spp), mul(mt, spt)), ct = add(mul(mp, spt), mul(mt, stt));
    g0 = add(g0, add(mul(cp, px), mul(ct, tx)));
    g1 = add(g1, add(mul(cp, py), mul(ct, ty)));
    g2 = add(g2, add(mul(cp, pz), mul(ct, tz)));
    if (curvature) {
      const two = add(one, one);
      const kpp = mul(area, add(mul(mul(mul(two, warp), mp), mp), mul(mul(shear, mt), mt)));
      const ktt = mul(area, add(mul(mul(mul(two, weft), mt), mt), mul(mul(shear, mp), mp)));
      const kpt = mul(mul(mul(area, add(mul(two, cross), shear)), mp), mt);
      const pull = most(add(mul(cp, mp), mul(ct, mt)), ZERO);
      const bpx = add(mul(kpp, px), mul(kpt, tx)), bpy = add(mul(kpp, py), mul(kpt, ty)), bpz = add(mul(kpp, pz), mul(kpt, tz));
      const btx = add(mul(kpt, px), mul(ktt, tx)), bty = add(mul(kpt, py), mul(ktt, ty)), btz = add(mul(kpt, pz), mul(ktt, tz));
      h0 = add(add(mad(h0, bpx, px), mul(btx, tx)), pull);
      h1 = add(mad(h1, bpx, py), mul(btx, ty));
      h2 = add(mad(h2, bpx, pz), mul(btx, tz));
      h3 = add(add(mad(h3, bpy, py), mul(bty, ty)), pull);
      h4 = add(mad(h4, bpy, pz), mul(bty, tz));
      h5 = add(add(mad(h5, bpz, pz), mul(btz, tz)), pull);
    }
  }
  const bend = at(A.BEND_OTHER) + off, value = at(A.BEND_VALUE) + off;
  const last = whole(at(A.BEND_START), b + 1);
  for (let row = whole(at(A.BEND_START), b); row < last; row++) {
    gather(x, bend + row * ROW);
    const w = v128.load(value + row * ROW);
    g0 = mad(g0, w, sub(gx, ox));
    g1 = mad(g1, w, sub(gy, oy));
    g2 = mad(g2, w, sub(gz, oz));
  }
  const begin = whole(at(A.CREASE_START), b), finish = whole(at(A.CREASE_START), b + 1);
  if (begin < finish) {
    putRows(scratch + off, g0, g1, g2);
    if (curvature) {
      putRows(scratch + HESSIAN + off, h0, h1, h2);
      putRows(scratch + HESSIAN + 3 * ROW + off, h3, h4, h5);
    }
    addCreases(x, begin, finish, 4 * q, scratch, curvature);
    rows(scratch + off);
    g0 = gx; g1 = gy; g2 = gz;
    if (curvature) {
      rows(scratch + HESSIAN + off);
      h0 = gx; h1 = gy; h2 = gz;
      rows(scratch + HESSIAN + 3 * ROW + off);
      h3 = gx; h4 = gy; h5 = gz;
    }
  }
}

// Weight, planes, leash and friction at the points, with bending's diagonal.
@inline function outside(
  x: v128, y: v128, z: v128, b: i32, off: i32, place: usize, network: usize, curvature: bool,
): void {
  const own = at(A.OWN) + 4 * b * ROW + off;
  const gap = all(constant(A.GAP)), one = all(1);
  const contact = v128.load(own, 128), leash = v128.load(own, 192);
  rows(place + 3 * ROW);
  const nx = gx, ny = gy, nz = gz;
  rows(place + OTHER_PLANE + 3 * ROW);
  const mx = gx, my = gy, mz = gz;
  rows(place);
  const depth = sub(gap, dot(sub(x, gx), sub(y, gy), sub(z, gz), nx, ny, nz));
  let stiffness = above(depth, ZERO, contact, ZERO);
  rows(place + OTHER_PLANE);
  const deep = sub(gap, dot(sub(x, gx), sub(y, gy), sub(z, gz), mx, my, mz));
  let stiff = above(deep, ZERO, contact, ZERO);
  points(network);
  const wx = sub(x, gx), wy = sub(y, gy), wz = sub(z, gz);
  const held = v128.load(place + HELD_ROW), slack = v128.load(place + SLACK_ROW);
  const length = root(most(square(wx, wy, wz), mul(slack, slack)));
  let pull = mul(held, sub(one, div(slack, length)));
  rows(place + STUCK);
  let sx = sub(x, gx), sy = sub(y, gy), sz = sub(z, gz);
  const along = dot(sx, sy, sz, nx, ny, nz);
  sx = sub(sx, mul(along, nx)); sy = sub(sy, mul(along, ny)); sz = sub(sz, mul(along, nz));
  let grip = mul(v128.load(place + FRICTION_ROW), most(depth, ZERO));
  grip = div(grip, root(most(square(sx, sy, sz), all(SLIP_M * SLIP_M))));
  if (!curvature) {
    const known = add(leash, mul(all(HOLD), contact));
    const less = div(known, most(add(grip, above(length, slack, held, ZERO)), known));
    pull = mul(less, pull); grip = mul(less, grip);
    const share = div(contact, most(mad(stiffness, stiff, square(mx, my, mz)), contact));
    stiffness = mul(share, stiffness); stiff = mul(share, stiff);
  }
  const first = f32x4.neg(mul(stiffness, depth)), second = f32x4.neg(mul(stiff, deep));
  g0 = add(add(mul(first, nx), mul(second, mx)), add(mul(pull, wx), mul(grip, sx)));
  g1 = add(add(add(mul(first, ny), mul(second, my)), add(mul(pull, wy), mul(grip, sy))), v128.load(own));
  g2 = add(add(mul(first, nz), mul(second, mz)), add(mul(pull, wz), mul(grip, sz)));
  if (!curvature) return;
  const still = add(add(add(all(constant(A.LEAST)), v128.load(own, 64)), pull), grip);
  const across = sub(stiffness, grip);
  const lost = above(length, slack, div(mul(held, slack), mul(mul(length, length), length)), ZERO);
  const ux = mul(across, nx), uy = mul(across, ny), uz = mul(across, nz);
  const vx = mul(stiff, mx), vy = mul(stiff, my), vz = mul(stiff, mz);
  const lx = mul(lost, wx), ly = mul(lost, wy), lz = mul(lost, wz);
  h0 = add(mad(mad(still, ux, nx), vx, mx), mul(lx, wx));
  h1 = add(mad(mul(ux, ny), vx, my), mul(lx, wy));
  h2 = add(mad(mul(ux, nz), vx, mz), mul(lx, wz));
  h3 = add(mad(mad(still, uy, ny), vy, my), mul(ly, wy));
  h4 = add(mad(mul(uy, nz), vy, mz), mul(ly, wz));
  h5 = add(mad(mad(still, uz, nz), vz, mz), mul(lz, wz));
}
