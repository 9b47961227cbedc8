// Frames of the network's surface, and the residuals kept in them. A copy of drape/live/surface_frames.py and residual.py for browsers.
import * as A from "./arrays";
import { at, constant, reserved } from "./arrays";
import {
  ONE, QUAD, ROW, ZERO, above, add, all, ax, ay, az, det, div, dot, gather, gx, gy, gz, mad, most, mul, points, putPoints, putRows, root, rows, square, sub, whole,
} from "./vectors";

export const COVER: i32 = 9 * ROW;
export const FRAMES: i32 = 10 * ROW; // bytes of a block

const MEND_M: f32 = 0.03;
const FORGET: f32 = 24;
const LACK: f64 = 0.003;
const HEM: f32 = 24;

const eased: usize = memory.data(64, 16); // four points

@inline function perLength(squared: v128): v128 {
  return above(squared, ZERO, div(ONE, root(above(squared, ZERO, squared, ONE))), ZERO);
}

export function surfaceFrames(surface: usize, blocks: i32, frames: usize): void {
  for (let b = 0; b < blocks; b++) {
    const begin = whole(at(A.FAN_START), b), end = whole(at(A.FAN_START), b + 1);
    for (let q = 0; q < 4; q++) {
      const fan = at(A.FAN_OTHER) + q * QUAD, slope = at(A.FAN_SLOPE) + q * QUAD;
      points(surface + (4 * b + q) * 64);
      const ox = gx, oy = gy, oz = gz;
      let nx = ZERO, ny = ZERO, nz = ZERO, ex = ZERO, ey = ZERO, ez = ZERO, twice = ZERO, area = ZERO;
      for (let row = begin; row < end; row++) {
        gather(surface, fan + 2 * row * ROW);
        const fx = sub(gx, ox), fy = sub(gy, oy), fz = sub(gz, oz);
        gather(surface, fan + (2 * row + 1) * ROW);
        const sx = sub(gx, ox), sy = sub(gy, oy), sz = sub(gz, oz);
        const cx = det(fy, fz, sz, sy), cy = det(fz, fx, sx, sz), cz = det(fx, fy, sy, sx);
        nx = add(nx, cx); ny = add(ny, cy); nz = add(nz, cz);
        twice = add(twice, root(square(cx, cy, cz)));
        area = add(area, v128.load(slope + (5 * row + 4) * ROW));
        if (row == begin) { ex = fx; ey = fy; ez = fz; }
      }
      let per = perLength(square(nx, ny, nz));
      nx = mul(per, nx); ny = mul(per, ny); nz = mul(per, nz);
      const along = dot(ex, ey, ez, nx, ny, nz);
      ex = sub(ex, mul(along, nx)); ey = sub(ey, mul(along, ny)); ez = sub(ez, mul(along, nz));
      per = perLength(square(ex, ey, ez));
      ex = mul(per, ex); ey = mul(per, ey); ez = mul(per, ez);
      const to = frames + b * FRAMES + q * QUAD;
      putRows(to, nx, ny, nz);
      putRows(to + 3 * ROW, ex, ey, ez);
      putRows(to + 6 * ROW, det(ny, nz, ez, ey), det(nz, nx, ex, ez), det(nx, ny, ey, ex));
      v128.store(to + COVER, div(mul(all(0.5), twice), above(area, ZERO, area, ONE)));
    }
  }
}

// to = R^T (share from), from frames to the world.
export function toWorld(from: usize, share: f32, blocks: i32, frames: usize, to: usize): void {
  const s = all(share);
  for (let b = 0; b < blocks; b++) {
    for (let q = 0; q < 4; q++) {
      const place = (4 * b + q) * 64, frame = frames + b * FRAMES + q * QUAD;
      points(from + place);
      const a = mul(s, gx), e = mul(s, gy), c = mul(s, gz);
      rows(frame);
      let x = mul(a, gx), y = mul(a, gy), z = mul(a, gz);
      rows(frame + 3 * ROW);
      x = mad(x, e, gx); y = mad(y, e, gy); z = mad(z, e, gz);
      rows(frame + 6 * ROW);
      putPoints(to + place, mad(x, c, gx), mad(y, c, gy), mad(z, c, gz));
    }
  }
}

// to = R (share (from - origin)), from the world to frames.
export function toFrames(from: usize, origin: usize, share: f32, blocks: i32, frames: usize, to: usize): void {
  const s = all(share);
  for (let b = 0; b < blocks; b++) {
    for (let q = 0; q < 4; q++) {
      const place = (4 * b + q) * 64, frame = frames + b * FRAMES + q * QUAD;
      points(from + place);
      let x = gx, y = gy, z = gz;
      if (origin != 0) {
        points(origin + place);
        x = sub(x, gx); y = sub(y, gy); z = sub(z, gz);
      }
      x = mul(s, x); y = mul(s, y); z = mul(s, z);
      rows(frame);
      const n = dot(gx, gy, gz, x, y, z);
      rows(frame + 3 * ROW);
      const e = dot(gx, gy, gz, x, y, z);
      rows(frame + 6 * ROW);
      putPoints(to + place, n, e, dot(gx, gy, gz, x, y, z));
    }
  }
}

// Mends, forgets and evens the residuals off; copy: room for as many points.
export function keepResidual(off: usize, before: usize, network: usize, blocks: i32, frames: usize, copy: usize): void {
  memory.copy(copy, off, <usize>blocks * 1024);
  for (let b = 0; b < blocks; b++) {
    const begin = whole(at(A.FAN_START), b), end = whole(at(A.FAN_START), b + 1);
    if (begin == end) continue; // without neighbours: stays
    for (let q = 0; q < 4; q++) {
      const place = (4 * b + q) * 64, fan = at(A.FAN_OTHER) + q * QUAD;
      const forget = forgotten(before, network, place, fan + 2 * begin * ROW, frames + b * FRAMES + q * QUAD);
      toMean(copy, b, q, forget, all(MEND_M * MEND_M), off + place);
    }
  }
  evenHem(off, before, network, copy);
}

// Writes four vectors of off after a share of their way to the neighbours' mean, all of it where it is longer than the
// root of far.
@inline function toMean(off: usize, b: i32, q: i32, forget: v128, far: v128, to: usize): void {
  const begin = whole(at(A.FAN_START), b), end = whole(at(A.FAN_START), b + 1);
  const place = (4 * b + q) * 64, fan = at(A.FAN_OTHER) + q * QUAD;
  const own = i32x4.add(i32x4.splat(16 * b + 4 * q), i32x4(0, 1, 2, 3));
  points(off + place);
  const ox = gx, oy = gy, oz = gz;
  let mx = ZERO, my = ZERO, mz = ZERO, count = ZERO;
  for (let row = 2 * begin; row < 2 * end; row++) {
    const index = fan + row * ROW;
    const real = v128.and(ONE, i32x4.ne(v128.load(index), own)); // an empty row has the place itself
    gather(off, index);
    mx = mad(mx, real, gx); my = mad(my, real, gy); mz = mad(mz, real, gz);
    count = add(count, real);
  }
  const per = div(ONE, above(count, ZERO, count, ONE));
  const wx = sub(mul(per, mx), ox), wy = sub(mul(per, my), oy), wz = sub(mul(per, mz), oz);
  const share = above(count, ZERO, above(square(wx, wy, wz), far, ONE, forget), ZERO);
  putPoints(to, mad(ox, share, wx), mad(oy, share, wy), mad(oz, share, wz));
}

// Moves the residuals of x a share of the way to their neighbours' mean where crossed is above zero; copy: room for as
// many points.
export function ease(x: usize, network: usize, crossed: usize, share: f32, blocks: i32, copy: usize): void {
  for (let p: usize = 0; p < <usize>blocks * 1024; p += 16) {
    v128.store(copy + p, sub(v128.load(x + p), v128.load(network + p)));
  }
  for (let b = 0; b < blocks; b++) {
    for (let q = 0; q < 4; q++) {
      const first = 16 * b + 4 * q, hit = f32x4.gt(v128.load(crossed + (<usize>first << 2)), ZERO);
      if (!v128.any_true(hit)) continue;
      toMean(copy, b, q, v128.and(hit, all(share)), all(Infinity), eased);
      for (let lane = 0; lane < 4; lane++) {
        if (!(load<f32>(crossed + (<usize>(first + lane) << 2)) > 0)) continue;
        const to = <usize>(first + lane) << 4;
        v128.store(x + to, add(v128.load(network + to), v128.load(eased + (<usize>lane << 4))));
      }
    }
  }
}

@inline function forgotten(before: usize, network: usize, place: usize, index: usize, frame: usize): v128 {
  points(network + place);
  const nx = gx, ny = gy, nz = gz;
  gather(network, index);
  const ex = sub(gx, nx), ey = sub(gy, ny), ez = sub(gz, nz);
  points(before + place);
  const bx = gx, by = gy, bz = gz;
  gather(before, index);
  const tx = sub(ex, sub(gx, bx)), ty = sub(ey, sub(gy, by)), tz = sub(ez, sub(gz, bz));
  const lacks = mul(all(<f32>(1.0 / LACK)), most(sub(ONE, v128.load(frame + COVER)), ZERO));
  const length = square(ex, ey, ez);
  let s = mul(all(FORGET), root(div(square(tx, ty, tz), above(length, ZERO, length, ONE))));
  s = div(s, add(ONE, mul(lacks, lacks)));
  return div(s, add(ONE, s));
}

function evenHem(off: usize, before: usize, network: usize, even: usize): void {
  const hem = at(A.HEM), count = reserved(A.HEM) / 3;
  for (let e = 0; e < count; e++) {
    const first = whole(hem, 3 * e), v = whole(hem, 3 * e + 1), after = whole(hem, 3 * e + 2);
    const x = ax(network, after) - ax(network, v), y = ay(network, after) - ay(network, v), z = az(network, after) - az(network, v);
    const u = x - (ax(before, after) - ax(before, v)), w = y - (ay(before, after) - ay(before, v));
    const t = z - (az(before, after) - az(before, v));
    const length = x * x + y * y + z * z;
    const s: f32 = length > 0 ? HEM * Mathf.sqrt((u * u + w * w + t * t) / length) : 0;
    const own = v128.load(off + (<usize>v << 4));
    const mean = mul(all(0.5), add(v128.load(off + (<usize>first << 4)), v128.load(off + (<usize>after << 4))));
    v128.store(even + (<usize>e << 4), mad(own, all(s / (1 + s)), sub(mean, own)));
  }
  for (let e = 0; e < count; e++) {
    v128.store(off + ((<usize>whole(hem, 3 * e + 1)) << 4), v128.load(even + (<usize>e << 4)));
  }
}
