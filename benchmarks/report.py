"""Writes the committed results into the documents, between ``<!-- NAME:begin -->`` and ``<!-- NAME:end -->``.

python -m benchmarks.report
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.common import RESULTS_DIR, ROOT

QUALITY_COLUMNS = ("edge_pct", "area_pct", "colliding_vertex_pct", "colliding_triangle_pct", "energy_j", "gain")


def quality_table(record: dict[str, Any]) -> str:
    """Every garment and method of ``benchmarks.quality``."""
    lines = [
        "| garment | method | edge % | area % | colliding % (vertex) | colliding % (triangle) | energy [J] | gain |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in record["rows"]:
        values = [f"{row[c]:.2f}" if row[c] is not None else "-" for c in QUALITY_COLUMNS]
        lines.append(f"| {row['garment']} | {row['method']} | " + " | ".join(values) + " |")
    return "\n".join([*lines, "", provenance(record)])


def gain_table(record: dict[str, Any]) -> str:
    """The short form for the README: one line per garment."""
    methods = ("skinning_push", "network_push", "physics")
    lines = [
        "| garment | edge strain %: skinning + push-out | network + push-out | physics | gain |",
        "|---|---|---|---|---|",
    ]
    for garment in dict.fromkeys(row["garment"] for row in record["rows"]):
        rows = {row["method"]: row for row in record["rows"] if row["garment"] == garment}
        strains = " | ".join(f"{rows[m]['edge_pct']:.2f}" for m in methods)
        lines.append(f"| {garment} | {strains} | {rows['network_push']['gain']:.2f} |")
    return "\n".join([*lines, "", provenance(record)])


def provenance(record: dict[str, Any]) -> str:
    """The sentence under a table: machine, commit and command."""
    return f"Measured on {record['machine']}, commit {record['commit']}: `{record['command']}`."


def insert(path: Path, name: str, text: str) -> bool:
    """Puts ``text`` between the markers called ``name`` in ``path``; False where the file has none."""
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    content = path.read_text(encoding="utf-8")
    if begin not in content or end not in content:
        return False
    head, rest = content.split(begin, 1)
    path.write_text(f"{head}{begin}\n{text}\n{end}{rest.split(end, 1)[1]}", encoding="utf-8")
    return True


TABLES: tuple[tuple[str, str, str, Callable[[dict[str, Any]], str]], ...] = (
    ("quality", "docs/quality.md", "quality", quality_table),
    ("quality", "README.md", "gain", gain_table),
    ("quality_unseen", "docs/quality.md", "quality_unseen", quality_table),
)


def main() -> None:
    """Command line entry."""
    for bench, document, name, table in TABLES:
        result = RESULTS_DIR / f"{bench}.json"
        if not result.is_file():
            print(f"{document} {name}: no {result.name} yet")
            continue
        done = insert(ROOT / document, name, table(json.loads(result.read_text(encoding="utf-8"))))
        print(f"{document} {name}: {'written' if done else 'no markers'}")


if __name__ == "__main__":
    main()
