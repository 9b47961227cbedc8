"""Writes the tables of the committed records into ``docs/records``, and the figures that README and other pages state.

A page has a block ``<!-- record: NAME -->`` ... ``<!-- end of record -->`` ; ``BLOCKS`` makes the text between the two.
Within a sentence it marks a figure (``benchmarks/marked_figures.py``).

python -m benchmarks.report
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

from benchmarks import figures, guide_figures, judged_figures
from benchmarks.harness import RESULTS_DIR, ROOT
from benchmarks.marked_figures import FIGURE, fill_figures
from benchmarks.record_tables import TABLES
from benchmarks.tables import Record

FOLDER = ROOT / "docs" / "records"
BLOCK = re.compile(r"(<!-- record: (\w+) -->\n).*?(<!-- end of record -->)", re.DOTALL)
BLOCKS = figures.BLOCKS | judged_figures.BLOCKS | guide_figures.BLOCKS


def pages() -> dict[str, str]:
    """Returns the text of each page of docs/records by its file's name, which is that of the document that speaks of
    its records."""
    texts: dict[str, str] = {}
    for bench, document, name, table in TABLES:
        record = _record(bench)
        page = Path(document).name
        source = f"From [`{bench}.json`](../../benchmarks/results/{bench}.json)."
        section = f"\n## {name.replace('_', ' ')}\n\n{source}\n\n{table(record)}\n"
        texts[page] = texts.get(page, _head(document)) + section
    return texts


def stating() -> dict[str, str]:
    """Returns the text of each document that states figures, by its path under the root, with the figures that the
    records hold."""
    records = {path.stem: _record(path.stem) for path in RESULTS_DIR.glob("*.json")}
    texts = {path: path.read_text(encoding="utf-8") for path in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md"))}
    return {
        path.relative_to(ROOT).as_posix(): fill(text, records)
        for path, text in texts.items()
        if BLOCK.search(text) or FIGURE.search(text)
    }


def fill(text: str, records: Mapping[str, Record]) -> str:
    """Returns the page ``text`` with each of its blocks and marked figures as ``records``, by name, have it."""
    blocks = BLOCK.sub(lambda block: f"{block[1]}{BLOCKS[block[2]](records)}\n{block[3]}", text)
    return fill_figures(blocks, records)


def _record(name: str) -> Record:
    return json.loads((RESULTS_DIR / f"{name}.json").read_text(encoding="utf-8"))


def _head(document: str) -> str:
    subject = (ROOT / document).read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
    link = f"[{subject}](../{Path(document).relative_to('docs')})"
    return f"# Records: {subject}\n\nWritten by `python -m benchmarks.report`. What they mean: {link}.\n"


def main() -> None:
    """Runs the command line: writes all pages of docs/records, deletes those that no record is for, and writes the
    figures on other pages."""
    FOLDER.mkdir(exist_ok=True)
    texts = pages()
    for path in FOLDER.glob("*.md"):
        if path.name not in texts:
            path.unlink()
    for name, text in texts.items():
        (FOLDER / name).write_text(text, encoding="utf-8")
        print(f"docs/records/{name}: {len(text)} characters")
    for path, text in stating().items():
        (ROOT / path).write_text(text, encoding="utf-8")
        print(f"{path}: figures of the records")


if __name__ == "__main__":
    main()
