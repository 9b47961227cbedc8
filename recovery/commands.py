"""What the command lines of recovery share: their parsers, the style of a pattern, and how they end."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path

from recovery.pattern.bases import read_values
from recovery.pattern.style import PARTS, Style

NOT_AT_REST_EXIT_CODE = 3


def parser_of(module: str, text: str | None) -> argparse.ArgumentParser:
    """Returns a parser called ``python -m MODULE``; its help begins with ``text``, whose lines stay as they are."""
    raw = argparse.RawDescriptionHelpFormatter
    return argparse.ArgumentParser(prog=f"python -m {module}", description=text, formatter_class=raw)


def add_style_options(parser: argparse.ArgumentParser) -> None:
    """Adds ``--style``, ``--whole-sleeves`` and ``--whole-bands`` to a command that writes a pattern."""
    parser.add_argument(
        "--style",
        nargs="+",
        default=[],
        metavar="NAME=WIDTH",
        help=f"lines of the finished pattern, widths in metres: {', '.join(PARTS)}",
    )
    parser.add_argument("--whole-sleeves", action="store_true", help="join halves of sleeves along the top of the arm")
    parser.add_argument("--whole-bands", action="store_true", help="join the pieces of bands where their ends agree")


def style_of(given: argparse.Namespace) -> Style:
    """Returns the style that the parsed options of ``add_style_options`` ask for. Raises ``InputError`` for text that
    is not NAME=WIDTH."""
    return Style(read_values(given.style, "--style"), given.whole_sleeves, given.whole_bands)


def end_command(files: Iterable[Path], not_at_rest: str) -> int:
    """Prints the paths ``files``, and on standard error ``not_at_rest``, a sentence on cloth that is not at rest.
    Returns the exit code: 0 if that sentence is empty, else 3."""
    for path in files:
        print(path)
    if not_at_rest:
        print(not_at_rest, file=sys.stderr)
    return NOT_AT_REST_EXIT_CODE if not_at_rest else 0
