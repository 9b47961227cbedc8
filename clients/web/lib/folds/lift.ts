// The lift, which ends a frame. A copy of drape/live/lift.py for browsers.
import { OTHER_PLANE, PLANES } from "./sweeps";
import { ONE, QUAD, ROW, ZERO, above, all, dot, gx, gy, gz, least, mad, most, mul, points, putPoints, rows, sub } from "./vectors";

const OTHER: f32 = 0.25;
const DEEP_M: f32 = 0.006, TOO_DEEP_M: f32 = 0.02;

let x: v128 = f32x4.splat(0), y: v128 = f32x4.splat(0), z: v128 = f32x4.splat(0);

export function lift(at: usize, blocks: i32, planes: usize, clearance: f32): void {
  for (let b = 0; b < blocks; b++) {
    for (let q = 0; q < 4; q++) {
      const place = at + (4 * b + q) * 64, from = planes + b * PLANES + q * QUAD;
      points(place);
      x = gx; y = gy; z = gz;
      raise(from + OTHER_PLANE, clearance, OTHER);
      raise(from, clearance, 1);
      putPoints(place, x, y, z);
    }
  }
}

@inline function raise(plane: usize, clearance: f32, share: f32): void {
  rows(plane + 3 * ROW);
  const nx = gx, ny = gy, nz = gz;
  rows(plane);
  const low = sub(all(clearance), dot(sub(x, gx), sub(y, gy), sub(z, gz), nx, ny, nz));
  const fade = all(1 / (TOO_DEEP_M - DEEP_M));
  const left = least(most(sub(ONE, mul(fade, sub(low, all(DEEP_M)))), ZERO), ONE);
  const way = above(low, ZERO, mul(mul(all(share), left), low), ZERO);
  x = mad(x, way, nx); y = mad(y, way, ny); z = mad(z, way, nz);
}
