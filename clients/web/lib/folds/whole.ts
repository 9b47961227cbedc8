// A step of the whole cloth by the factor in panels. A copy of drape/live/whole.py for browsers.
import * as A from "./arrays";
import { at, reserved } from "./arrays";
import { ZERO, add, all, ax, ay, az, gx, gy, gz, mad, mul, number, turned, whole } from "./vectors";

const CLAMP_M: f32 = 0.02;

// y: as many points as vertices; s: rows of three for the largest panel.
export function wholeStep(x: usize, gradient: usize, share: f32, count: i32, y: usize, s: usize): void {
  const place = at(A.FACTOR_PLACE);
  for (let i = 0; i < count; i++) {
    v128.store(y + (<usize>i << 4), f32x4.neg(v128.load(gradient + ((<usize>whole(place, i)) << 4))));
  }
  solve(y, count, s);
  let most: f32 = 0;
  for (let i = 0; i < count; i++) {
    const a = ax(y, i), b = ay(y, i), c = az(y, i), square = a * a + b * b + c * c;
    if (!(square <= most)) most = square;
  }
  if (!(most < f32.MAX_VALUE)) return;
  const by = all(share * (CLAMP_M / max<f32>(Mathf.sqrt(most), CLAMP_M)));
  for (let i = 0; i < count; i++) {
    const to = x + ((<usize>whole(place, i)) << 4);
    v128.store(to, mad(v128.load(to), by, v128.load(y + (<usize>i << 4))));
  }
}

function solve(y: usize, count: i32, s: usize): void {
  const panels = reserved(A.FACTOR_SIZE), inverse = at(A.FACTOR_INVERSE);
  for (let panel = 0; panel < panels; panel++) down(panel, y, s);
  for (let i = 0; i < count; i++) {
    const to = y + (<usize>i << 4);
    v128.store(to, mul(v128.load(to), all(number(inverse, i))));
  }
  for (let panel = panels - 1; panel >= 0; panel--) up(panel, y, s);
}

// Adds what the columns of a panel say to its members.
function down(panel: i32, y: usize, s: usize): void {
  const first = whole(at(A.FACTOR_COLUMN), panel), last = whole(at(A.FACTOR_COLUMN), panel + 1);
  const begin = whole(at(A.FACTOR_START), panel), count = whole(at(A.FACTOR_START), panel + 1) - begin;
  const value = at(A.FACTOR_VALUE) + ((<usize>whole(at(A.FACTOR_ENTRY), panel)) << 2);
  const member = at(A.FACTOR_MEMBER) + (<usize>begin << 2);
  for (let row = 0; row < count; row += 4) {
    let a = ZERO, b = ZERO, c = ZERO;
    let entry = value + (<usize>row << 2);
    for (let j = first; j < last; j++) {
      const v = v128.load(entry);
      a = mad(a, v, all(ax(y, j)));
      b = mad(b, v, all(ay(y, j)));
      c = mad(c, v, all(az(y, j)));
      entry += <usize>count << 2;
    }
    const to = s + 12 * (<usize>row);
    v128.store(to, a);
    v128.store(to, b, 16);
    v128.store(to, c, 32);
  }
  const size = whole(at(A.FACTOR_SIZE), panel);
  for (let i = 0; i < size; i++) {
    const from = s + 48 * (<usize>(i >> 2)) + (<usize>(i & 3) << 2), to = y + ((<usize>whole(member, i)) << 4);
    store<f32>(to, load<f32>(to) + load<f32>(from));
    store<f32>(to, load<f32>(to, 4) + load<f32>(from, 16), 4);
    store<f32>(to, load<f32>(to, 8) + load<f32>(from, 32), 8);
  }
}

// Adds what the members of a panel say to its columns.
function up(panel: i32, y: usize, s: usize): void {
  const first = whole(at(A.FACTOR_COLUMN), panel), last = whole(at(A.FACTOR_COLUMN), panel + 1);
  const begin = whole(at(A.FACTOR_START), panel), count = whole(at(A.FACTOR_START), panel + 1) - begin;
  let entry = at(A.FACTOR_VALUE) + ((<usize>whole(at(A.FACTOR_ENTRY), panel)) << 2);
  const member = at(A.FACTOR_MEMBER) + (<usize>begin << 2);
  for (let row = 0; row < count; row += 4) {
    const index = member + (<usize>row << 2);
    turned(
      v128.load(y + ((<usize>whole(index, 0)) << 4)), v128.load(y + ((<usize>whole(index, 1)) << 4)),
      v128.load(y + ((<usize>whole(index, 2)) << 4)), v128.load(y + ((<usize>whole(index, 3)) << 4)),
    );
    const to = s + 12 * (<usize>row);
    v128.store(to, gx);
    v128.store(to, gy, 16);
    v128.store(to, gz, 32);
  }
  for (let j = first; j < last; j++) {
    let a = ZERO, b = ZERO, c = ZERO;
    for (let row = 0; row < count; row += 4) {
      const v = v128.load(entry + (<usize>row << 2)), from = s + 12 * (<usize>row);
      a = mad(a, v, v128.load(from));
      b = mad(b, v, v128.load(from, 16));
      c = mad(c, v, v128.load(from, 32));
    }
    entry += <usize>count << 2;
    const to = y + (<usize>j << 4);
    v128.store(to, add(v128.load(to), sums(a, b, c)));
  }
}

// The sums of the lanes of three rows, as a point.
@inline function sums(a: v128, b: v128, c: v128): v128 {
  const low = v128.shuffle<f32>(a, b, 0, 4, 1, 5), low2 = v128.shuffle<f32>(c, ZERO, 0, 4, 1, 5);
  const high = v128.shuffle<f32>(a, b, 2, 6, 3, 7), high2 = v128.shuffle<f32>(c, ZERO, 2, 6, 3, 7);
  const first = v128.shuffle<f32>(low, low2, 0, 1, 4, 5), second = v128.shuffle<f32>(low, low2, 2, 3, 6, 7);
  const third = v128.shuffle<f32>(high, high2, 0, 1, 4, 5), fourth = v128.shuffle<f32>(high, high2, 2, 3, 6, 7);
  return add(add(first, second), add(third, fourth));
}
