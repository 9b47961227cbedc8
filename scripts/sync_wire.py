"""Writes clients/web/src/wire.js from drape/wire.py. ``--check`` only compares and fails where they differ."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from drape import wire  # noqa: E402

TARGET = ROOT / "clients/web/src/wire.js"
SIZES = {"u8": 1, "u16": 2, "u32": 4, "f32": 4, "f64": 8}

TEMPLATE = """\
// Generated from drape/wire.py by scripts/sync_wire.py. Do not edit.

export const WIRE_VERSION = {version};
export const SUBPROTOCOL = "{subprotocol}";
export const MAGIC = {magic};
export const KIND = {{ POSE: {pose}, ACK: {ack}, FRAME: {frame} }};
export const FLAG_PUSHED = {flag_pushed};
export const BYTES = {{ POSE: {pose_bytes}, ACK: {ack_bytes}, FRAME_HEADER: {frame_bytes} }};

// name: [offset, type, count]
export const LAYOUTS = {{
{layouts}
}};

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

export function packAck(sequence) {{
  const buffer = new ArrayBuffer(BYTES.ACK);
  writeRecord(new DataView(buffer), LAYOUTS.ACK, prefix(KIND.ACK, sequence, 0));
  return buffer;
}}

// The header fields by name, and steps: Uint16Array of 3 per vertex. Throws on what is not a frame.
export function unpackFrame(buffer) {{
  if (buffer.byteLength < BYTES.FRAME_HEADER) throw new Error(`frame of ${{buffer.byteLength}} bytes is too short`);
  const header = readRecord(new DataView(buffer), LAYOUTS.FRAME);
  if (header.magic !== MAGIC || header.version !== WIRE_VERSION || header.kind !== KIND.FRAME) {{
    throw new Error("not a frame of this wire version: reload the page");
  }}
  const steps = new Uint16Array(buffer, BYTES.FRAME_HEADER, header.count * 3);
  return {{ header, steps }};
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
        flag_pushed=wire.FLAG_PUSHED,
        pose_bytes=wire.POSE_BYTES,
        ack_bytes=wire.ACK_BYTES,
        frame_bytes=wire.FRAME_HEADER_BYTES,
        layouts=layouts,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    check = parser.parse_args().check
    text = generate()
    if check:
        same = TARGET.is_file() and TARGET.read_text(encoding="utf-8") == text
        if not same:
            print(f"{TARGET.relative_to(ROOT)} is stale: run python scripts/sync_wire.py", file=sys.stderr)
        return 0 if same else 1
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(text, encoding="utf-8")
    print(f"wrote {TARGET.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
