"""Writes clients/web/lib/src/wire.js from drape/wire/ and the table of drape/files/formats.py, and records.js beside it
from drape/engine/records.py.

``--check`` only compares and fails where they differ.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from drape.engine.records import HASH, RECORDS  # noqa: E402
from drape.files.formats import BESIDE_SUFFIXES, MESH_SUFFIXES  # noqa: E402
from drape.geometry import jets  # noqa: E402
from drape.wire import jets as wire_jets  # noqa: E402
from drape.wire import layout as jet_layout  # noqa: E402
from drape.wire import meshes as wire_meshes  # noqa: E402
from drape.wire import messages as wire  # noqa: E402
from drape.wire import rig_poses  # noqa: E402

TARGET = ROOT / "clients/web/lib/src/wire.js"
RECORDS_TARGET = TARGET.with_name("records.js")
# What a page lays into memory, with the records that are part of these.
LAID = (
    "Levels", "FoldConstants", "FoldMemory", "FoldEffort", "Surroundings", "SwingConstants", "SwingMemory",
    "Weights", "PatchRows", "BodyFeed", "PosedBody", "PosedJets", "Tiles",
)  # fmt: skip
SIZES = {"u8": 1, "u16": 2, "u32": 4, "f32": 4, "f64": 8}

TEMPLATE = """\
// Generated from drape/wire/ and drape/files/formats.py by scripts/sync_wire.py. Do not edit.

export const WIRE_VERSION = {version};
export const SUBPROTOCOL = "{subprotocol}";
export const MAGIC = {magic};
export const KIND = {{
  POSE: {pose}, ACK: {ack}, FRAME: {frame}, JETS: {jets}, LAYOUT: {layout}, CLIP: {clip}, STATE: {state}, SAME: {same},
  RIG_POSE: {rig_pose}, FOLDS: {folds}, MESH: {mesh}, BODY: {body},
}};
export const FLAG_PUSHED = {flag_pushed};
export const FLAG_STEPPED = {flag_stepped};
export const FLAG_UNLIKE = {flag_unlike};
export const FLAG_BYTES = {flag_bytes};
// Suffixes of garment files, and of those that they name, as the file chooser takes them.
export const MESH_SUFFIXES = "{suffixes}";
export const BESIDE_SUFFIXES = "{beside}";
export const BYTES = {{
  POSE: {pose_bytes}, ACK: {ack_bytes}, SAME: {same_bytes}, RIG_POSE_HEADER: {rig_pose_bytes},
  FRAME_HEADER: {frame_bytes}, JETS_HEADER: {jets_bytes}, LAYOUT_HEADER: {layout_bytes},
  MESH_HEADER: {mesh_bytes}, BODY_HEADER: {body_bytes},
}};

// name: [offset, type, count]
export const LAYOUTS = {{
{layouts}
}};

// Of JETS: numbers of a jet, which of them have 16 bits and which have 8, columns of 16 bits, steps of a unit.
export const JET_NUMBERS = {jet_numbers};
const FINE = {fine};
const COARSE = {coarse};
const FINE_COLUMNS = {fine_columns};
const ROW_BYTES = {row_bytes};
const UNIT = {unit};
// Of LAYOUT: float32 numbers of a patch (rotation, centre, scale) and of a chart (weight, u, v).
const PATCH_NUMBERS = {patch_numbers};
const CHART_NUMBERS = {chart_numbers};

const GET = {{ u8: "getUint8", u16: "getUint16", u32: "getUint32", f32: "getFloat32", f64: "getFloat64" }};
const SET = {{ u8: "setUint8", u16: "setUint16", u32: "setUint32", f32: "setFloat32", f64: "setFloat64" }};
const SIZE = {{ u8: 1, u16: 2, u32: 4, f32: 4, f64: 8 }};

function readRecord(view, layout) {{
  const record = {{}};
  for (const [name, [offset, type, count]] of Object.entries(layout)) {{
    const read = (i) => view[GET[type]](offset + i * SIZE[type], true);
    record[name] = count === 1 ? read(0) : Array.from({{ length: count }}, (_, i) => read(i));
  }}
  return record;
}}

function writeRecord(view, layout, record) {{
  for (const [name, [offset, type, count]] of Object.entries(layout)) {{
    const values = count === 1 ? [record[name]] : record[name];
    for (let i = 0; i < count; i++) view[SET[type]](offset + i * SIZE[type], values[i], true);
  }}
}}

const prefix = (kind, sequence, count) => ({{ magic: MAGIC, version: WIRE_VERSION, kind, flags: 0, sequence, count }});

// pose: 72 rotation-vector components [rad]; trans: 3 numbers [m]; time in seconds of the client's clock.
export function packPose({{ sequence, clientTimeS, trans, pose }}) {{
  const buffer = new ArrayBuffer(BYTES.POSE);
  const record = {{ ...prefix(KIND.POSE, sequence, 1), client_time_s: clientTimeS, trans, pose }};
  writeRecord(new DataView(buffer), LAYOUTS.POSE, record);
  return buffer;
}}

// quaternions: x, y, z, w of each node of the avatar, one after the other; place: 3 numbers [m], or null for its rest.
export function packRigPose({{ sequence, clientTimeS, place, quaternions }}) {{
  const buffer = new ArrayBuffer(BYTES.RIG_POSE_HEADER + 4 * quaternions.length);
  const head = {{ ...prefix(KIND.RIG_POSE, sequence, quaternions.length / 4), flags: place ? 1 : 0 }};
  const record = {{ ...head, client_time_s: clientTimeS, trans: place ?? [0, 0, 0] }};
  writeRecord(new DataView(buffer), LAYOUTS.RIG_POSE, record);
  new Float32Array(buffer, BYTES.RIG_POSE_HEADER).set(quaternions);
  return buffer;
}}

export function packAck(sequence) {{
  const buffer = new ArrayBuffer(BYTES.ACK);
  writeRecord(new DataView(buffer), LAYOUTS.ACK, prefix(KIND.ACK, sequence, 0));
  return buffer;
}}

export function readHeader(buffer, name, bytes) {{
  if (buffer.byteLength < bytes) throw new Error(`${{name}} of ${{buffer.byteLength}} bytes is too short`);
  const header = readRecord(new DataView(buffer), LAYOUTS[name]);
  if (header.magic !== MAGIC || header.version !== WIRE_VERSION || header.kind !== KIND[name]) {{
    throw new Error(`not a ${{name}} message of this wire version: reload the page`);
  }}
  return header;
}}

function checkSize(buffer, name, bytes) {{
  if (buffer.byteLength !== bytes + (-bytes & 3)) throw new Error(`${{name}} has a wrong size: reload the page`);
}}

// The fields of a POSE by name.
export const unpackPose = (buffer) => readHeader(buffer, "POSE", BYTES.POSE);

// The kind byte of a message.
export const kindOf = (buffer) => new DataView(buffer).getUint8(5);

// The header fields by name, and steps: 3 per vertex, a Uint16Array, or a Uint8Array where they have 8 bits.
// Throws on what is not a frame.
export function unpackFrame(buffer) {{
  const header = readHeader(buffer, "FRAME", BYTES.FRAME_HEADER);
  const Steps = header.flags & FLAG_BYTES ? Uint8Array : Uint16Array;
  const steps = new Steps(buffer, BYTES.FRAME_HEADER, header.count * 3);
  return {{ header, steps }};
}}

// The header fields by name of a message that answers a pose: FRAME, JETS or SAME.
export function headerOf(buffer) {{
  const kind = kindOf(buffer);
  if (kind === KIND.SAME) return readHeader(buffer, "SAME", BYTES.SAME);
  return kind === KIND.JETS
    ? readHeader(buffer, "JETS", BYTES.JETS_HEADER)
    : readHeader(buffer, "FRAME", BYTES.FRAME_HEADER);
}}

// The header fields by name, and per patch: jet (45 numbers), rotation (9, by rows), centre (3) from the root [m].
export function unpackJets(buffer) {{
  const header = readHeader(buffer, "JETS", BYTES.JETS_HEADER);
  const {{ count, centre_low, centre_step, jet_low, jet_step }} = header;
  checkSize(buffer, "JETS", BYTES.JETS_HEADER + count * ROW_BYTES);
  const fine = new Uint16Array(buffer, BYTES.JETS_HEADER, count * FINE_COLUMNS);
  const coarse = new Uint8Array(buffer, BYTES.JETS_HEADER + 2 * fine.length, count * COARSE.length);
  const jet = new Float32Array(JET_NUMBERS * count);
  const rotation = new Float32Array(9 * count);
  const centre = new Float32Array(3 * count);
  for (let k = 0; k < count; k++) {{
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
    const put = (number, step) => {{ jet[JET_NUMBERS * k + number] = jet_low[number] + jet_step[number] * step; }};
    FINE.forEach((number, i) => put(number, fine[at + 7 + i]));
    COARSE.forEach((number, i) => put(number, coarse[k * COARSE.length + i]));
  }}
  return {{ header, jet, rotation, centre }};
}}

// A garment's constants: patches (13 numbers each), rest (3), charts (3 per vertex and chart) and chartPatch.
export function unpackLayout(buffer) {{
  const {{ count, vertices, charts }} = readHeader(buffer, "LAYOUT", BYTES.LAYOUT_HEADER);
  const entries = vertices * charts;
  const floats = PATCH_NUMBERS * count + 3 * vertices + CHART_NUMBERS * entries;
  checkSize(buffer, "LAYOUT", BYTES.LAYOUT_HEADER + 4 * floats + 2 * entries);
  const numbers = new Float32Array(buffer, BYTES.LAYOUT_HEADER, floats);
  const restAt = PATCH_NUMBERS * count;
  return {{
    count, vertices, charts,
    patches: numbers.subarray(0, restAt),
    rest: numbers.subarray(restAt, restAt + 3 * vertices),
    chart: numbers.subarray(restAt + 3 * vertices),
    chartPatch: new Uint16Array(buffer, BYTES.LAYOUT_HEADER + 4 * floats, entries),
  }};
}}

// Root-relative positions [m] into target (Float32Array of 3 per vertex).
export function dequantise({{ header, steps }}, target) {{
  const [x, y, z] = header.box_low;
  const [sx, sy, sz] = header.box_step;
  for (let i = 0; i < steps.length; i += 3) {{
    target[i] = x + sx * steps[i];
    target[i + 1] = y + sy * steps[i + 1];
    target[i + 2] = z + sz * steps[i + 2];
  }}
}}
"""


def layout_text(layout: wire.Layout) -> str:
    """The fields of ``layout`` with their offsets, as lines of a JavaScript object."""
    offset, lines = 0, []
    for name, kind, count in layout:
        lines.append(f'    {name}: [{offset}, "{kind}", {count}],')
        offset += SIZES[kind] * count
    return "\n".join(lines)


def generate() -> str:
    """The text of wire.js."""
    layouts = "\n".join(f"  {name}: {{\n{layout_text(layout)}\n  }}," for name, layout in wire.LAYOUTS.items())
    return TEMPLATE.format(
        version=wire.WIRE_VERSION,
        subprotocol=wire.SUBPROTOCOL,
        magic=f"0x{wire.MAGIC:x}",
        pose=wire.POSE,
        ack=wire.ACK,
        frame=wire.FRAME,
        jets=wire.JETS,
        clip=wire.CLIP,
        layout=wire.LAYOUT,
        state=wire.STATE,
        same=wire.SAME,
        rig_pose=wire.RIG_POSE,
        folds=wire.FOLDS,
        mesh=wire.MESH,
        body=wire.BODY,
        mesh_bytes=wire_meshes.MESH_HEADER_BYTES,
        body_bytes=wire_meshes.BODY_HEADER_BYTES,
        jets_bytes=wire_jets.HEADER_BYTES,
        layout_bytes=jet_layout.HEADER_BYTES,
        jet_numbers=jets.FULL_COUNT,
        fine=wire_jets.FINE.tolist(),
        coarse=wire_jets.COARSE.tolist(),
        fine_columns=wire_jets.FINE_COLUMNS,
        row_bytes=wire_jets.ROW_BYTES,
        unit=wire_jets.UNIT,
        patch_numbers=jet_layout.PATCH_NUMBERS,
        chart_numbers=jet_layout.CHART_NUMBERS,
        flag_pushed=wire.FLAG_PUSHED,
        flag_stepped=wire.FLAG_STEPPED,
        flag_unlike=wire.FLAG_UNLIKE,
        flag_bytes=wire.FLAG_BYTES,
        suffixes=",".join(MESH_SUFFIXES),
        beside=",".join(BESIDE_SUFFIXES),
        pose_bytes=wire.POSE_BYTES,
        ack_bytes=wire.ACK_BYTES,
        same_bytes=wire.SAME_BYTES,
        rig_pose_bytes=rig_poses.HEADER_BYTES,
        frame_bytes=wire.FRAME_HEADER_BYTES,
        layouts=layouts,
    )


def records_text() -> str:
    """The text of records.js."""
    names: dict[str, None] = {}

    def take(name: str) -> None:
        for kind in RECORDS[name].values():
            if kind.removesuffix("[]") in RECORDS:
                take(kind.removesuffix("[]"))
        names[name] = None

    for name in LAID:
        take(name)
    lines = [
        "// Generated from drape/engine/records.py by scripts/sync_wire.py. Do not edit.",
        "",
        "// Of the whole table, a part of which follows: fields of records in their order, with their kinds.",
        f'export const LAYOUT = "{HASH:016x}";',
        "export const RECORDS = {",
    ]
    for name in names:
        fields = ", ".join(f'{field}: "{kind}"' for field, kind in RECORDS[name].items())
        lines.append(f"  {name}: {{ {fields} }},")
    return "\n".join([*lines, "};"]) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    check = parser.parse_args().check
    stale = False
    for target, text in ((TARGET, generate()), (RECORDS_TARGET, records_text())):
        if check and not (target.is_file() and target.read_text(encoding="utf-8") == text):
            print(f"{target.relative_to(ROOT)} is stale: run python scripts/sync_wire.py", file=sys.stderr)
            stale = True
        if not check:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(text, encoding="utf-8")
            print(f"wrote {target.relative_to(ROOT)}")
    return int(stale)


if __name__ == "__main__":
    sys.exit(main())
