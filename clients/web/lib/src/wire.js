// Messages as drape/wire packs them; wire_table.js has their layouts.
import {
  WIRE_VERSION, MAGIC, KIND, FLAG_BYTES, BYTES, LAYOUTS, JET_NUMBERS, FINE, COARSE, FINE_COLUMNS, ROW_BYTES,
  UNIT, PATCH_NUMBERS, CHART_NUMBERS,
} from "./wire_table.js";

export * from "./wire_table.js";

const GET = { u8: "getUint8", u16: "getUint16", u32: "getUint32", f32: "getFloat32", f64: "getFloat64" };
const SET = { u8: "setUint8", u16: "setUint16", u32: "setUint32", f32: "setFloat32", f64: "setFloat64" };
const SIZE = { u8: 1, u16: 2, u32: 4, f32: 4, f64: 8 };

function readRecord(view, layout) {
  const record = {};
  for (const [name, [offset, type, count]] of Object.entries(layout)) {
    const read = (i) => view[GET[type]](offset + i * SIZE[type], true);
    record[name] = count === 1 ? read(0) : Array.from({ length: count }, (_, i) => read(i));
  }
  return record;
}

function writeRecord(view, layout, record) {
  for (const [name, [offset, type, count]] of Object.entries(layout)) {
    const values = count === 1 ? [record[name]] : record[name];
    for (let i = 0; i < count; i++) view[SET[type]](offset + i * SIZE[type], values[i], true);
  }
}

const prefix = (kind, sequence, count) => ({ magic: MAGIC, version: WIRE_VERSION, kind, flags: 0, sequence, count });

// pose: 72 rotation-vector components [rad]; trans: 3 numbers [m]; time in seconds of the client's clock.
export function packPose({ sequence, clientTimeS, trans, pose }) {
  const buffer = new ArrayBuffer(BYTES.POSE);
  const record = { ...prefix(KIND.POSE, sequence, 1), client_time_s: clientTimeS, trans, pose };
  writeRecord(new DataView(buffer), LAYOUTS.POSE, record);
  return buffer;
}

// quaternions: x, y, z, w of each node of the avatar, one after the other; place: 3 numbers [m], or null for its rest.
export function packRigPose({ sequence, clientTimeS, place, quaternions }) {
  const buffer = new ArrayBuffer(BYTES.RIG_POSE_HEADER + 4 * quaternions.length);
  const head = { ...prefix(KIND.RIG_POSE, sequence, quaternions.length / 4), flags: place ? 1 : 0 };
  const record = { ...head, client_time_s: clientTimeS, trans: place ?? [0, 0, 0] };
  writeRecord(new DataView(buffer), LAYOUTS.RIG_POSE, record);
  new Float32Array(buffer, BYTES.RIG_POSE_HEADER).set(quaternions);
  return buffer;
}

export function packAck(sequence) {
  const buffer = new ArrayBuffer(BYTES.ACK);
  writeRecord(new DataView(buffer), LAYOUTS.ACK, prefix(KIND.ACK, sequence, 0));
  return buffer;
}

export function readHeader(buffer, name, bytes) {
  if (buffer.byteLength < bytes) throw new Error(`${name} of ${buffer.byteLength} bytes is too short`);
  const header = readRecord(new DataView(buffer), LAYOUTS[name]);
  if (header.magic !== MAGIC || header.version !== WIRE_VERSION || header.kind !== KIND[name]) {
    throw new Error(`not a ${name} message of this wire version: reload the page`);
  }
  return header;
}

function checkSize(buffer, name, bytes) {
  if (buffer.byteLength !== bytes + (-bytes & 3)) throw new Error(`${name} has a wrong size: reload the page`);
}

// The fields of a POSE by name.
export const unpackPose = (buffer) => readHeader(buffer, "POSE", BYTES.POSE);

// The kind byte of a message.
export const kindOf = (buffer) => new DataView(buffer).getUint8(5);

// The header fields by name, and steps: 3 per vertex, a Uint16Array, or a Uint8Array where they have 8 bits.
// Throws on what is not a frame.
export function unpackFrame(buffer) {
  const header = readHeader(buffer, "FRAME", BYTES.FRAME_HEADER);
  const Steps = header.flags & FLAG_BYTES ? Uint8Array : Uint16Array;
  const steps = new Steps(buffer, BYTES.FRAME_HEADER, header.count * 3);
  return { header, steps };
}

// The header fields by name of a message that answers a pose: FRAME, JETS or SAME.
export function headerOf(buffer) {
  const kind = kindOf(buffer);
  if (kind === KIND.SAME) return readHeader(buffer, "SAME", BYTES.SAME);
  return kind === KIND.JETS
    ? readHeader(buffer, "JETS", BYTES.JETS_HEADER)
    : readHeader(buffer, "FRAME", BYTES.FRAME_HEADER);
}

// The header fields by name, and per patch: jet (45 numbers), rotation (9, by rows), centre (3) from the root [m].
export function unpackJets(buffer) {
  const header = readHeader(buffer, "JETS", BYTES.JETS_HEADER);
  const { count, centre_low, centre_step, jet_low, jet_step } = header;
  checkSize(buffer, "JETS", BYTES.JETS_HEADER + count * ROW_BYTES);
  const fine = new Uint16Array(buffer, BYTES.JETS_HEADER, count * FINE_COLUMNS);
  const coarse = new Uint8Array(buffer, BYTES.JETS_HEADER + 2 * fine.length, count * COARSE.length);
  const jet = new Float32Array(JET_NUMBERS * count);
  const rotation = new Float32Array(9 * count);
  const centre = new Float32Array(3 * count);
  for (let k = 0; k < count; k++) {
    const at = k * FINE_COLUMNS;
    for (let i = 0; i < 3; i++) centre[3 * k + i] = centre_low[i] + centre_step[i] * fine[at + i];
    let [w, x, y, z] = [0, 1, 2, 3].map((i) => fine[at + 3 + i] / UNIT - 1);
    const norm = Math.hypot(w, x, y, z);
    [w, x, y, z] = [w / norm, x / norm, y / norm, z / norm];
    rotation.set([
      1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
      2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
      2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ], 9 * k);
    const put = (number, step) => { jet[JET_NUMBERS * k + number] = jet_low[number] + jet_step[number] * step; };
    FINE.forEach((number, i) => put(number, fine[at + 7 + i]));
    COARSE.forEach((number, i) => put(number, coarse[k * COARSE.length + i]));
  }
  return { header, jet, rotation, centre };
}

// A garment's constants: patches (13 numbers each), rest (3), charts (3 per vertex and chart) and chartPatch.
export function unpackLayout(buffer) {
  const { count, vertices, charts } = readHeader(buffer, "LAYOUT", BYTES.LAYOUT_HEADER);
  const entries = vertices * charts;
  const floats = PATCH_NUMBERS * count + 3 * vertices + CHART_NUMBERS * entries;
  checkSize(buffer, "LAYOUT", BYTES.LAYOUT_HEADER + 4 * floats + 2 * entries);
  const numbers = new Float32Array(buffer, BYTES.LAYOUT_HEADER, floats);
  const restAt = PATCH_NUMBERS * count;
  return {
    count, vertices, charts,
    patches: numbers.subarray(0, restAt),
    rest: numbers.subarray(restAt, restAt + 3 * vertices),
    chart: numbers.subarray(restAt + 3 * vertices),
    chartPatch: new Uint16Array(buffer, BYTES.LAYOUT_HEADER + 4 * floats, entries),
  };
}

// Root-relative positions [m] into target (Float32Array of 3 per vertex).
export function dequantise({ header, steps }, target) {
  const [x, y, z] = header.box_low;
  const [sx, sy, sz] = header.box_step;
  for (let i = 0; i < steps.length; i += 3) {
    target[i] = x + sx * steps[i];
    target[i + 1] = y + sy * steps[i + 1];
    target[i + 2] = z + sz * steps[i + 2];
  }
}
