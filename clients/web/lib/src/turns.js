// Vectors of three numbers and rotations as nine, row after row.
export const ONE = [1, 0, 0, 0, 1, 0, 0, 0, 1];
const ON_ONE_LINE = 1e-9;

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const less = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const times = (s, a) => [s * a[0], s * a[1], s * a[2]];
export const length = (a) => Math.hypot(...a);
// The part of a that is at right angles to the unit vector b.
export const across = (a, b) => less(a, times(dot(a, b), b));
export const mean = (points) => times(1 / points.length, points.reduce((a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]]));

export const turned = (m, a) => [dot(m.slice(0, 3), a), dot(m.slice(3, 6), a), dot(m.slice(6), a)];
export const transposed = (m) => [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]];
export const ofColumns = (a, b, c) => [a[0], b[0], c[0], a[1], b[1], c[1], a[2], b[2], c[2]];
export const column = (m, n) => [m[n], m[3 + n], m[6 + n]];
export const product = (...all) => all.reduce((a, b) => ofColumns(...[0, 1, 2].map((n) => turned(a, column(b, n)))));

// The rotation of a rotation vector [rad].
export function ofVector(v) {
  const angle = length(v);
  if (angle < 1e-12) return [1, -v[2], v[1], v[2], 1, -v[0], -v[1], v[0], 1];
  const [x, y, z] = times(1 / angle, v);
  const [s, c] = [Math.sin(angle), Math.cos(angle)];
  const d = 1 - c;
  return [
    c + d * x * x, d * x * y - s * z, d * x * z + s * y,
    d * x * y + s * z, c + d * y * y, d * y * z - s * x,
    d * x * z - s * y, d * y * z + s * x, c + d * z * z,
  ];
}

// The rotation vector [rad] of a rotation, by the largest of its quaternion's four numbers.
export function toVector(m) {
  const [xx, yy, zz] = [m[0], m[4], m[8]];
  const squares = [1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz];
  const largest = squares.indexOf(Math.max(...squares));
  const rows = [
    [squares[0], m[7] - m[5], m[2] - m[6], m[3] - m[1]],
    [m[7] - m[5], squares[1], m[1] + m[3], m[2] + m[6]],
    [m[2] - m[6], m[1] + m[3], squares[2], m[5] + m[7]],
    [m[3] - m[1], m[2] + m[6], m[5] + m[7], squares[3]],
  ];
  const [w, ...axis] = rows[largest].map((number) => (rows[largest][0] < 0 ? -number : number));
  const sine = length(axis);
  return times(sine > 1e-12 * w ? (2 * Math.atan2(sine, w)) / sine : 2 / w, axis);
}

// The smallest rotation of the unit vector start onto end; half a turn goes about a side axis of frame.
export function leastTurn(start, end, frame = ONE) {
  const axis = cross(start, end);
  const [sine, cosine] = [length(axis), dot(start, end)];
  if (sine >= ON_ONE_LINE) return ofVector(times(Math.atan2(sine, cosine) / sine, axis));
  if (cosine > 0) return ONE;
  const side = across(column(frame, Math.abs(dot(column(frame, 0), start)) < 0.9 ? 0 : 2), start);
  return ofVector(times(Math.PI / length(side), side));
}
