// Vectors of four lanes: rows x, y and z hold four vertices side by side.
//
// Points are stored as x, y, z and a free number: POINT bytes each. A block of LANES vertices of one colour is four
// quads, which may be computed one after the other, since no two of its vertices share an element.

export const LANES: i32 = 16;
export const ROW: i32 = 64; // bytes of a row of LANES numbers
export const QUAD: i32 = 16; // bytes of four numbers of a row
export const POINT: i32 = 16; // bytes of a point

export const ZERO: v128 = f32x4.splat(0);
export const ONE: v128 = f32x4.splat(1);

@inline export function add(a: v128, b: v128): v128 { return f32x4.add(a, b); }
@inline export function sub(a: v128, b: v128): v128 { return f32x4.sub(a, b); }
@inline export function mul(a: v128, b: v128): v128 { return f32x4.mul(a, b); }
@inline export function div(a: v128, b: v128): v128 { return f32x4.div(a, b); }
@inline export function root(a: v128): v128 { return f32x4.sqrt(a); }
@inline export function all(a: f32): v128 { return f32x4.splat(a); }
// The larger and the smaller one, b where one is NaN.
@inline export function most(a: v128, b: v128): v128 { return f32x4.pmax(b, a); }
@inline export function least(a: v128, b: v128): v128 { return f32x4.pmin(b, a); }
// then in the lanes where a is above b, other in the rest.
@inline export function above(a: v128, b: v128, then: v128, other: v128): v128 {
  return v128.bitselect(then, other, f32x4.gt(a, b));
}
// a + s b
@inline export function mad(a: v128, s: v128, b: v128): v128 { return f32x4.add(a, f32x4.mul(s, b)); }
// a c - b d
@inline export function det(a: v128, b: v128, c: v128, d: v128): v128 {
  return f32x4.sub(f32x4.mul(a, c), f32x4.mul(b, d));
}
@inline export function dot(ax: v128, ay: v128, az: v128, bx: v128, by: v128, bz: v128): v128 {
  return f32x4.add(f32x4.add(f32x4.mul(ax, bx), f32x4.mul(ay, by)), f32x4.mul(az, bz));
}
@inline export function square(x: v128, y: v128, z: v128): v128 { return dot(x, y, z, x, y, z); }

// What turned() leaves: the first, second, third and fourth numbers of four vectors.
export let gx: v128 = f32x4.splat(0);
export let gy: v128 = f32x4.splat(0);
export let gz: v128 = f32x4.splat(0);
export let gw: v128 = f32x4.splat(0);

@inline export function turned(a: v128, b: v128, c: v128, d: v128): void {
  const low = v128.shuffle<f32>(a, b, 0, 4, 1, 5), low2 = v128.shuffle<f32>(c, d, 0, 4, 1, 5);
  const high = v128.shuffle<f32>(a, b, 2, 6, 3, 7), high2 = v128.shuffle<f32>(c, d, 2, 6, 3, 7);
  gx = v128.shuffle<f32>(low, low2, 0, 1, 4, 5);
  gy = v128.shuffle<f32>(low, low2, 2, 3, 6, 7);
  gz = v128.shuffle<f32>(high, high2, 0, 1, 4, 5);
  gw = v128.shuffle<f32>(high, high2, 2, 3, 6, 7);
}

@inline function pointAt(x: usize, index: usize, lane: i32): v128 {
  return v128.load(x + ((<usize>load<i32>(index + (lane << 2))) << 4));
}
// Four points of x by the whole numbers from index on, in gx, gy and gz.
@inline export function gather(x: usize, index: usize): void {
  turned(pointAt(x, index, 0), pointAt(x, index, 1), pointAt(x, index, 2), pointAt(x, index, 3));
}
// Four points from an address on.
@inline export function points(x: usize): void {
  turned(v128.load(x), v128.load(x, 16), v128.load(x, 32), v128.load(x, 48));
}
@inline export function putPoints(p: usize, x: v128, y: v128, z: v128): void {
  const low = v128.shuffle<f32>(x, y, 0, 4, 1, 5), high = v128.shuffle<f32>(x, y, 2, 6, 3, 7);
  const low2 = v128.shuffle<f32>(z, ZERO, 0, 4, 1, 5), high2 = v128.shuffle<f32>(z, ZERO, 2, 6, 3, 7);
  v128.store(p, v128.shuffle<f32>(low, low2, 0, 1, 4, 5));
  v128.store(p, v128.shuffle<f32>(low, low2, 2, 3, 6, 7), 16);
  v128.store(p, v128.shuffle<f32>(high, high2, 0, 1, 4, 5), 32);
  v128.store(p, v128.shuffle<f32>(high, high2, 2, 3, 6, 7), 48);
}
// Three rows of a block, from the quad at p on, in gx, gy and gz; and back.
@inline export function rows(p: usize): void {
  gx = v128.load(p);
  gy = v128.load(p, 64);
  gz = v128.load(p, 128);
}
@inline export function putRows(p: usize, x: v128, y: v128, z: v128): void {
  v128.store(p, x);
  v128.store(p, y, 64);
  v128.store(p, z, 128);
}

@inline export function whole(p: usize, i: i32): i32 { return load<i32>(p + ((<usize>i) << 2)); }
@inline export function number(p: usize, i: i32): f32 { return load<f32>(p + ((<usize>i) << 2)); }

// The parts of a stored point.
@inline export function ax(x: usize, v: i32): f32 { return load<f32>(x + ((<usize>v) << 4)); }
@inline export function ay(x: usize, v: i32): f32 { return load<f32>(x + ((<usize>v) << 4), 4); }
@inline export function az(x: usize, v: i32): f32 { return load<f32>(x + ((<usize>v) << 4), 8); }

// Squares of the distance between two points.
@inline export function apart(x: usize, v: i32, y: usize, u: i32): f32 {
  const a = ax(x, v) - ax(y, u), b = ay(x, v) - ay(y, u), c = az(x, v) - az(y, u);
  return a * a + b * b + c * c;
}
