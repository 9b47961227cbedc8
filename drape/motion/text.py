"""Lines and numbers of text motion files, with line numbers for every refusal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from drape.errors import MotionError

MAX_FILE_BYTES = 128 << 20
"""Largest text file [bytes] that is read: about 20 minutes of BVH at 120 Hz."""

Line = tuple[int, list[str]]
"""A line's number, from 1, and its words."""


def read_lines(path: Path) -> list[Line]:
    """The lines of a text file that hold words; comments after ``#`` are dropped."""
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise MotionError(
                path.name,
                expected=f"at most {MAX_FILE_BYTES} bytes",
                got=str(size),
                cure="Cut the clip into shorter files.",
            )
        # Latin-1 decodes any bytes; only names and comments can hold other than ASCII.
        text = path.read_bytes().decode("latin-1")
    except OSError as cause:
        raise MotionError(path.name, expected="a readable file", got=str(cause), cure="Check the path.") from cause
    split = ((number, line.split("#", 1)[0].split()) for number, line in enumerate(text.splitlines(), 1))
    return [(number, words) for number, words in split if words]


def fault(path: Path, number: int, expected: str, got: str, cure: str = "Export the file again.") -> MotionError:
    """A refusal that names the file and the line."""
    return MotionError(f"{Path(path).name}, line {number}", expected=expected, got=got, cure=cure)


def parse_numbers(path: Path, number: int, words: Sequence[str], *, count: int, what: str) -> list[float]:
    """``count`` finite numbers of a line."""
    if len(words) != count:
        raise fault(path, number, f"{count} numbers for {what}", str(len(words)))
    try:
        values = [float(word) for word in words]
    except ValueError as cause:
        raise fault(path, number, f"numbers for {what}", repr(" ".join(words)[:60])) from cause
    if not all(math.isfinite(value) for value in values):
        raise fault(
            path, number, f"finite numbers for {what}", repr(" ".join(words)[:60]), "Repair or cut the broken frames."
        )
    return values
