"""Writes the committed records into the documents, between ``<!-- NAME:begin -->`` and ``<!-- NAME:end -->``.

python -m benchmarks.report
"""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.measure import tables as quality
from benchmarks.papers import tables as papers
from benchmarks.papers.polyfit import tables as polyfit
from benchmarks.recovery import tables as recovery
from benchmarks.shared.common import RESULTS_DIR, ROOT
from benchmarks.speed import tables as speed
from benchmarks.training import tables as training

# Record, document, name between the markers, and what makes the text of the record.
TABLES = (*quality.TABLES, *speed.TABLES, *training.TABLES, *recovery.TABLES, *papers.TABLES, *polyfit.TABLES)


def insert(path: Path, name: str, text: str) -> bool:
    """Puts ``text`` between the markers called ``name`` in ``path``; False where the file has none."""
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    content = path.read_text(encoding="utf-8")
    if begin not in content or end not in content:
        return False
    head, rest = content.split(begin, 1)
    path.write_text(f"{head}{begin}\n{text}\n{end}{rest.split(end, 1)[1]}", encoding="utf-8")
    return True


def main() -> None:
    """Command line entry."""
    for bench, document, name, made in TABLES:
        record = json.loads((RESULTS_DIR / f"{bench}.json").read_text(encoding="utf-8"))
        done = insert(ROOT / document, name, made(record))
        print(f"{document} {name}: {'written' if done else 'no markers'}")


if __name__ == "__main__":
    main()
