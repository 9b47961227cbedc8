// The posed samples of the skin. A copy of forward kinematics (drape/geometry/rigid.py) and skin_table (drape/contact/skin.py) for browsers.
import * as A from "./arrays";
import { at, reserved } from "./arrays";
import { SAMPLE } from "./contact";
import { ZERO, all, det, div, dot, gw, gx, gy, gz, mad, most, mul, number, root, square, turned, whole } from "./vectors";

const JOINTS: i32 = 24;
const PART: i32 = 48; // samples of a part
const COLUMNS: i32 = 3 * PART; // of a part's rows: points, first and second tangents

const local: usize = memory.data(9 * 8, 16);
const turns: usize = memory.data(24 * 9 * 8, 16); // of the bones
const joints: usize = memory.data(24 * 3 * 8, 16); // posed, from the root
const moves: usize = memory.data(24 * 12 * 4, 16); // the bones' transforms by rows, three of four numbers each
const posed: usize = memory.data(9 * 48 * 4, 16);

@inline function get(p: usize, i: i32): f64 { return load<f64>(p + (<usize>i << 3)); }
@inline function set(p: usize, i: i32, value: f64): void { store<f64>(p + (<usize>i << 3), value); }

// The rotation by the vector (x, y, z) [rad], by rows.
function rotate(x: f64, y: f64, z: f64): void {
  const square = x * x + y * y + z * z, angle = Math.sqrt(square);
  const small = angle < 1e-6;
  const s = small ? 1 - square / 6 : Math.sin(angle) / angle, half = Math.sin(0.5 * angle);
  const c = small ? 0.5 - square / 24 : 2 * half * half / square;
  set(local, 0, 1 - c * (y * y + z * z)); set(local, 1, c * x * y - s * z); set(local, 2, c * x * z + s * y);
  set(local, 3, c * x * y + s * z); set(local, 4, 1 - c * (x * x + z * z)); set(local, 5, c * y * z - s * x);
  set(local, 6, c * x * z - s * y); set(local, 7, c * y * z + s * x); set(local, 8, 1 - c * (x * x + y * y));
}

function move(pose: usize): void {
  const rest = at(A.JOINTS), parents = at(A.PARENTS);
  for (let j = 0; j < JOINTS; j++) {
    rotate(<f64>number(pose, 3 * j), <f64>number(pose, 3 * j + 1), <f64>number(pose, 3 * j + 2));
    const own = turns + 72 * <usize>j, parent = whole(parents, j), above = turns + 72 * <usize>parent;
    for (let a = 0; a < 3; a++) {
      if (parent < 0) {
        for (let b = 0; b < 3; b++) set(own, 3 * a + b, get(local, 3 * a + b));
        set(joints, 3 * j + a, 0);
        continue;
      }
      let place = get(joints, 3 * parent + a);
      for (let k = 0; k < 3; k++) place += get(above, 3 * a + k) * <f64>(number(rest, 3 * j + k) - number(rest, 3 * parent + k));
      set(joints, 3 * j + a, place);
      for (let b = 0; b < 3; b++) {
        set(own, 3 * a + b, get(above, 3 * a) * get(local, b) + get(above, 3 * a + 1) * get(local, 3 + b) + get(above, 3 * a + 2) * get(local, 6 + b));
      }
    }
    for (let a = 0; a < 3; a++) {
      const to = moves + 48 * <usize>j + 16 * <usize>a;
      let shift = get(joints, 3 * j + a);
      for (let b = 0; b < 3; b++) {
        store<f32>(to + (<usize>b << 2), <f32>get(own, 3 * a + b));
        shift -= get(own, 3 * a + b) * <f64>number(rest, 3 * j + b);
      }
      store<f32>(to, <f32>shift, 12);
    }
  }
}

// Writes the samples of the skin in the pose, 72 numbers [rad], from the root.
export function poseSkin(pose: usize, skin: usize): void {
  move(pose);
  const parts = reserved(A.REACH_M2) / PART, bones = at(A.SKIN_BONES), count = reserved(A.SKIN_BONES) / parts;
  for (let p = 0; p < parts; p++) {
    const rows = at(A.SKIN_ROWS) + <usize>(p * count) * 4 * COLUMNS * 4;
    for (let column = 0; column < COLUMNS; column += 4) {
      let x = ZERO, y = ZERO, z = ZERO;
      for (let k = 0; k < count; k++) {
        const move = moves + 48 * <usize>whole(bones, p * count + k), row = rows + <usize>(k * 4 * COLUMNS + column) * 4;
        for (let c = 0; c < 4; c++) {
          const value = v128.load(row + <usize>(c * COLUMNS) * 4), m = move + (<usize>c << 2);
          x = mad(x, v128.load32_splat(m), value);
          y = mad(y, v128.load32_splat(m, 16), value);
          z = mad(z, v128.load32_splat(m, 32), value);
        }
      }
      const to = posed + <usize>((column / PART) * 3 * PART + column % PART) * 4;
      v128.store(to, x);
      v128.store(to + PART * 4, y);
      v128.store(to + 2 * PART * 4, z);
    }
    for (let s = 0; s < PART; s += 4) tabulate(posed + (<usize>s << 2), skin + <usize>(p * PART + s) * SAMPLE);
  }
}

@inline function tabulate(from: usize, to: usize): void {
  const r = <usize>PART * 4;
  const px = v128.load(from), py = v128.load(from + r), pz = v128.load(from + 2 * r);
  const ux = v128.load(from + 3 * r), uy = v128.load(from + 4 * r), uz = v128.load(from + 5 * r);
  const wx = v128.load(from + 6 * r), wy = v128.load(from + 7 * r), wz = v128.load(from + 8 * r);
  let nx = det(uy, uz, wz, wy), ny = det(uz, ux, wx, wz), nz = det(ux, uy, wy, wx);
  const per = div(all(1), root(most(square(nx, ny, nz), all(1e-12))));
  nx = mul(per, nx); ny = mul(per, ny); nz = mul(per, nz);
  turned(px, py, pz, square(px, py, pz));
  v128.store(to, gx); v128.store(to, gy, 32); v128.store(to, gz, 64); v128.store(to, gw, 96);
  turned(nx, ny, nz, dot(nx, ny, nz, px, py, pz));
  v128.store(to, gx, 16); v128.store(to, gy, 48); v128.store(to, gz, 80); v128.store(to, gw, 112);
}
