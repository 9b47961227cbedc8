// Generated from drape/wire.py by scripts/sync_wire.py. Do not edit.

export const WIRE_VERSION = 1;
export const SUBPROTOCOL = "drape.v1";
export const MAGIC = 0x45505244;
export const KIND = { POSE: 1, ACK: 2, FRAME: 3 };
export const FLAG_PUSHED = 1;
export const BYTES = { POSE: 336, ACK: 16, FRAME_HEADER: 96 };

// name: [offset, type, count]
export const LAYOUTS = {
  POSE: {
    magic: [0, "u32", 1],
    version: [4, "u8", 1],
    kind: [5, "u8", 1],
    flags: [6, "u16", 1],
    sequence: [8, "u32", 1],
    count: [12, "u32", 1],
    client_time_s: [16, "f64", 1],
    trans: [24, "f64", 3],
    pose: [48, "f32", 72],
  },
  ACK: {
    magic: [0, "u32", 1],
    version: [4, "u8", 1],
    kind: [5, "u8", 1],
    flags: [6, "u16", 1],
    sequence: [8, "u32", 1],
    count: [12, "u32", 1],
  },
  FRAME: {
    magic: [0, "u32", 1],
    version: [4, "u8", 1],
    kind: [5, "u8", 1],
    flags: [6, "u16", 1],
    sequence: [8, "u32", 1],
    count: [12, "u32", 1],
    client_time_s: [16, "f64", 1],
    server_time_s: [24, "f64", 1],
    root: [32, "f64", 3],
    box_low: [56, "f32", 3],
    box_step: [68, "f32", 3],
    dropped: [80, "u32", 1],
    residence_us: [84, "u32", 1],
    pushed_share: [88, "f32", 1],
    push_max_m: [92, "f32", 1],
  },
};

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

export function packAck(sequence) {
  const buffer = new ArrayBuffer(BYTES.ACK);
  writeRecord(new DataView(buffer), LAYOUTS.ACK, prefix(KIND.ACK, sequence, 0));
  return buffer;
}

// The header fields by name, and steps: Uint16Array of 3 per vertex. Throws on what is not a frame.
export function unpackFrame(buffer) {
  if (buffer.byteLength < BYTES.FRAME_HEADER) throw new Error(`frame of ${buffer.byteLength} bytes is too short`);
  const header = readRecord(new DataView(buffer), LAYOUTS.FRAME);
  if (header.magic !== MAGIC || header.version !== WIRE_VERSION || header.kind !== KIND.FRAME) {
    throw new Error("not a frame of this wire version: reload the page");
  }
  const steps = new Uint16Array(buffer, BYTES.FRAME_HEADER, header.count * 3);
  return { header, steps };
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
