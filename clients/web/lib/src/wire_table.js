// Generated from drape/wire/ and drape/files/formats.py by scripts/sync_wire.py. Do not edit.

export const WIRE_VERSION = 1;
export const SUBPROTOCOL = "drape.v1";
export const MAGIC = 0x45505244;
export const KIND = {
  POSE: 1, ACK: 2, FRAME: 3, JETS: 4, LAYOUT: 5, CLIP: 6, STATE: 7, SAME: 8,
  RIG_POSE: 9, FOLDS: 10, MESH: 11, BODY: 12,
};
export const FLAG_PUSHED = 1;
export const FLAG_STEPPED = 2;
export const FLAG_UNLIKE = 4;
export const FLAG_BYTES = 8;
// Suffixes of garment files, and of those that they name, as the file chooser takes them.
export const MESH_SUFFIXES = ".obj,.glb,.gltf,.ply,.stl,.usd,.usda,.usdc,.usdz,.fbx,.zip";
export const BESIDE_SUFFIXES = ".mtl,.bin,.png,.jpg,.jpeg,.webp,.tga,.bmp,.ktx2";
export const BYTES = {
  POSE: 336, ACK: 16, SAME: 40, RIG_POSE_HEADER: 48,
  FRAME_HEADER: 96, JETS_HEADER: 460, LAYOUT_HEADER: 24,
  MESH_HEADER: 32, BODY_HEADER: 316,
};

// name: [offset, type, count]
const PREFIX = {
    magic: [0, "u32", 1], version: [4, "u8", 1], kind: [5, "u8", 1], flags: [6, "u16", 1], sequence: [8, "u32", 1],
    count: [12, "u32", 1]
};
export const LAYOUTS = {
  POSE: {
    ...PREFIX,
    client_time_s: [16, "f64", 1], trans: [24, "f64", 3], pose: [48, "f32", 72]
  },
  FRAME: {
    ...PREFIX,
    client_time_s: [16, "f64", 1], server_time_s: [24, "f64", 1], root: [32, "f64", 3], box_low: [56, "f32", 3],
    box_step: [68, "f32", 3], dropped: [80, "u32", 1], residence_us: [84, "u32", 1], pushed_share: [88, "f32", 1],
    push_max_m: [92, "f32", 1]
  },
  JETS: {
    ...PREFIX,
    client_time_s: [16, "f64", 1], server_time_s: [24, "f64", 1], root: [32, "f64", 3], dropped: [56, "u32", 1],
    residence_us: [60, "u32", 1], pushed_share: [64, "f32", 1], push_max_m: [68, "f32", 1], left_m: [72, "f32", 1],
    centre_low: [76, "f32", 3], centre_step: [88, "f32", 3], jet_low: [100, "f32", 45], jet_step: [280, "f32", 45]
  },
  SAME: {
    ...PREFIX,
    client_time_s: [16, "f64", 1], server_time_s: [24, "f64", 1], dropped: [32, "u32", 1],
    residence_us: [36, "u32", 1]
  },
  LAYOUT: {
    ...PREFIX,
    vertices: [16, "u32", 1], charts: [20, "u32", 1]
  },
  CLIP: {
    ...PREFIX,
    text_bytes: [16, "u32", 1], nodes: [20, "u32", 1]
  },
  RIG_POSE: {
    ...PREFIX,
    client_time_s: [16, "f64", 1], trans: [24, "f64", 3]
  },
  MESH: {
    ...PREFIX,
    copies: [16, "u32", 1], triangles: [20, "u32", 1], uv_step: [24, "f32", 1], uv_metres: [28, "f32", 1]
  },
  BODY: {
    ...PREFIX,
    triangles: [16, "u32", 1], step_m: [20, "f32", 1], weight_step: [24, "f32", 1], joints: [28, "f32", 72]
  },
  ACK: PREFIX,
};

// Of JETS: numbers of a jet, which of them have 16 bits and which have 8, columns of 16 bits, steps of a unit.
export const JET_NUMBERS = 45;
export const FINE = [0, 1, 2, 3, 4, 5, 15, 16, 17, 18, 19, 20, 30, 31, 32, 33, 34, 35];
export const COARSE = [6, 7, 8, 9, 10, 11, 12, 13, 14, 21, 22, 23, 24, 25, 26, 27, 28, 29, 36, 37, 38, 39, 40, 41, 42, 43, 44];
export const FINE_COLUMNS = 25;
export const ROW_BYTES = 77;
export const UNIT = 32767;
// Of LAYOUT: float32 numbers of a patch (rotation, centre, scale) and of a chart (weight, u, v).
export const PATCH_NUMBERS = 13;
export const CHART_NUMBERS = 3;
