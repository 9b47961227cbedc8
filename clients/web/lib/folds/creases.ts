// Hinges that are not flat at rest, one corner at a time. A copy of drape/kernels/elements.py (hinge_corner) for browsers.
import * as A from "./arrays";
import { at, constant } from "./arrays";
import { ROW, ax, ay, az, number, whole } from "./vectors";

export const HESSIAN: i32 = 3 * ROW;

// Vectors of hinge(): the edge e, the arms a and b, the normals n and m, and derivatives of the fold and of the angle.
const E: usize = memory.data(4 * 3 * 16, 16);
const AA: usize = E + 12, B: usize = E + 24, N: usize = E + 36, M: usize = E + 48;
const BY_N: usize = E + 60, BY_M: usize = E + 72, BY_E: usize = E + 84, BY_A: usize = E + 96, BY_B: usize = E + 108;
const FORCE: usize = E + 120, TURN: usize = E + 132, TEMP: usize = E + 144;

@inline function get(p: usize, i: i32): f32 { return load<f32>(p + (<usize>i << 2)); }
@inline function set(p: usize, i: i32, value: f32): void { store<f32>(p + (<usize>i << 2), value); }
function dot3(a: usize, b: usize): f32 { return get(a, 0) * get(b, 0) + get(a, 1) * get(b, 1) + get(a, 2) * get(b, 2); }
function cross3(to: usize, a: usize, b: usize): void {
  const x = get(a, 1) * get(b, 2) - get(a, 2) * get(b, 1);
  const y = get(a, 2) * get(b, 0) - get(a, 0) * get(b, 2);
  const z = get(a, 0) * get(b, 1) - get(a, 1) * get(b, 0);
  set(to, 0, x); set(to, 1, y); set(to, 2, z);
}
// to = s a + t b
function mix3(to: usize, s: f32, a: usize, t: f32, b: usize): void {
  for (let i = 0; i < 3; i++) set(to, i, s * get(a, i) + t * get(b, i));
}
// to += s a
function more3(to: usize, s: f32, a: usize): void {
  for (let i = 0; i < 3; i++) set(to, i, get(to, i) + s * get(a, i));
}

// Leaves the derivatives of the fold by a corner in FORCE and of the angle in TURN.
function hinge(x: usize, h: i32, corner: i32): void {
  const cosine = number(at(A.CREASE_COSINE), h), sine = number(at(A.CREASE_SINE), h);
  const per = constant(A.PER_EDGE), degenerate = constant(A.DEGENERATE);
  const places = at(A.CREASE_CORNER) + ((<usize>h) << 4);
  const origin = whole(places, 0);
  for (let k = 0; k < 3; k++) {
    const v = whole(places, k + 1);
    set(E, 3 * k, per * (ax(x, v) - ax(x, origin)));
    set(E, 3 * k + 1, per * (ay(x, v) - ay(x, origin)));
    set(E, 3 * k + 2, per * (az(x, v) - az(x, origin)));
  }
  cross3(N, E, AA);
  cross3(M, B, E);
  const q1 = dot3(N, N), q2 = dot3(M, M);
  const scale: f32 = 1 / Mathf.sqrt(q1 * q2 + degenerate);
  const square = dot3(E, E) + degenerate, length = Mathf.sqrt(square), rise = dot3(N, B);
  const value = cosine * dot3(N, M) - sine * length * rise;
  const cube = value * scale * scale * scale;
  mix3(BY_N, -scale * cosine, M, scale * sine * length, B);
  more3(BY_N, cube * q2, N);
  mix3(BY_M, -scale * cosine, N, cube * q1, M);
  cross3(BY_E, AA, BY_N);
  cross3(TEMP, BY_M, B);
  more3(BY_E, 1, TEMP);
  more3(BY_E, scale * sine * rise / length, E);
  cross3(BY_A, BY_N, E);
  cross3(BY_B, E, BY_M);
  more3(BY_B, scale * sine * length, N);
  if (corner == 0) {
    for (let i = 0; i < 3; i++) set(FORCE, i, -(per * get(BY_E, i) + (per * get(BY_A, i) + per * get(BY_B, i))));
  } else {
    const by = corner == 1 ? BY_E : corner == 2 ? BY_A : BY_B;
    for (let i = 0; i < 3; i++) set(FORCE, i, per * get(by, i));
  }
  const over1 = per / (q1 + degenerate), over2 = per / (q2 + degenerate);
  const along1 = dot3(AA, E) / length, along2 = dot3(B, E) / length;
  if (corner == 0) mix3(TURN, (length - along1) * over1, N, (length - along2) * over2, M);
  else if (corner == 1) mix3(TURN, along1 * over1, N, along2 * over2, M);
  else if (corner == 2) mix3(TURN, -length * over1, N, 0, N);
  else mix3(TURN, -length * over2, M, 0, M);
}

// Adds the creases begin to end - 1 of the four lanes from first on to the rows of scratch.
export function addCreases(x: usize, begin: i32, end: i32, first: i32, scratch: usize, curvature: bool): void {
  for (let entry = begin; entry < end; entry++) {
    const lane = whole(at(A.CREASE_LANE), entry);
    if (lane < first || lane >= first + 4) continue;
    const member = whole(at(A.CREASE_MEMBER), entry), h = member >> 2;
    hinge(x, h, member & 3);
    const stiffness = number(at(A.CREASE_STIFFNESS), h);
    const to = scratch + (<usize>lane << 2);
    for (let i = 0; i < 3; i++) store<f32>(to + i * ROW, load<f32>(to + i * ROW) + stiffness * get(FORCE, i));
    if (!curvature) continue;
    let row = to + HESSIAN;
    for (let i = 0; i < 3; i++) {
      const turn = stiffness * get(TURN, i);
      for (let j = i; j < 3; j++) {
        store<f32>(row, load<f32>(row) + turn * get(TURN, j));
        row += ROW;
      }
    }
  }
}
