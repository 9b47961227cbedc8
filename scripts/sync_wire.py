"""Writes clients/web/lib/src/wire_table.js from drape/wire/ and the table of drape/files/formats.py, and records.js
beside it from drape/engine/records.py.

``--check`` only compares and fails where they differ.
"""

from __future__ import annotations

import argparse
import sys
import textwrap
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from drape.engine.records import HASH, RECORDS  # noqa: E402
from drape.files.formats import BESIDE_SUFFIXES, MESH_SUFFIXES  # noqa: E402
from drape.geometry import jets  # noqa: E402
from drape.wire import jets as wire_jets  # noqa: E402
from drape.wire import layout as jet_layout  # noqa: E402
from drape.wire import mesh_messages as wire_meshes  # noqa: E402
from drape.wire import messages as wire  # noqa: E402
from drape.wire import rig_pose_message  # noqa: E402

TARGET = ROOT / "clients/web/lib/src/wire_table.js"
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
const PREFIX = {{
{prefix}
}};
export const LAYOUTS = {{
{layouts}
}};

// Of JETS: numbers of a jet, which of them have 16 bits and which have 8, columns of 16 bits, steps of a unit.
export const JET_NUMBERS = {jet_numbers};
export const FINE = {fine};
export const COARSE = {coarse};
export const FINE_COLUMNS = {fine_columns};
export const ROW_BYTES = {row_bytes};
export const UNIT = {unit};
// Of LAYOUT: float32 numbers of a patch (rotation, centre, scale) and of a chart (weight, u, v).
export const PATCH_NUMBERS = {patch_numbers};
export const CHART_NUMBERS = {chart_numbers};
"""


def layout_text(layout: wire.Layout, skip: int = 0) -> str:
    """The fields of ``layout`` with their offsets, but for the first ``skip``, as part of a JavaScript object."""
    offset, fields = 0, []
    for name, kind, count in layout:
        fields.append(f'{name}: [{offset}, "{kind}", {count}]')
        offset += SIZES[kind] * count
    lines = textwrap.wrap(", ".join(field.replace(" ", "\0") for field in fields[skip:]), 114)
    return "\n".join(f"    {line}" for line in lines).replace("\0", " ")


def generate() -> str:
    """The text of wire_table.js."""
    first = len(wire.PREFIX)  # every layout begins with these fields
    texts = {name: layout_text(layout, first) for name, layout in wire.LAYOUTS.items()}
    layouts = "\n".join(f"  {name}: {{\n    ...PREFIX,\n{text}\n  }}," for name, text in texts.items() if text)
    layouts += "".join(f"\n  {name}: PREFIX," for name, text in texts.items() if not text)
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
        rig_pose_bytes=rig_pose_message.HEADER_BYTES,
        frame_bytes=wire.FRAME_HEADER_BYTES,
        prefix=layout_text(wire.PREFIX),
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
