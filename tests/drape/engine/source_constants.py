"""The numbers that the engine's sources declare, read out of them."""

from __future__ import annotations

import math
import re
from functools import cache

from drape.engine.build import SOURCE

DECLARED = re.compile(r"^constexpr (?:int|int64_t|double) ([^;{]+);", re.MULTILINE)
LISTED = re.compile(r"^(?:constexpr|TABLE) int (\w+)\[\w+\] = \{([^}]+)\};", re.MULTILINE)


@cache
def source_constants() -> dict[tuple[str, str], float | tuple[float, ...]]:
    """Every constant of a header by the header's name without its end, and its own."""
    found: dict[tuple[str, str], float | tuple[float, ...]] = {}
    declared = [
        (path.stem, *part.split(" = "))
        for path in sorted(SOURCE.glob("*.hpp"))
        for match in DECLARED.finditer(path.read_text())
        for part in match[1].split(", ")
    ]
    seen = {path.stem: included(path.stem) for path in SOURCE.glob("*.hpp")}
    while declared:  # an expression may have names of headers that come later
        left = []
        for header, name, text in declared:
            known = {key: value for (where, key), value in found.items() if where in seen[header]}
            try:
                value = eval(text.replace("__builtin_inf()", "inf"), {"inf": math.inf}, known)
            except NameError:
                left.append((header, name, text))
                continue
            found[header, name.strip()] = value
        assert len(left) < len(declared), f"names that no header declares: {left}"
        declared = left
    for path in SOURCE.glob("*.hpp"):
        for match in LISTED.finditer(path.read_text()):
            found[path.stem, match[1]] = tuple(int(number) for number in match[2].split(","))
    return found


def included(header: str) -> set[str]:
    """The headers that ``header`` sees, by their names without ends: itself too."""
    names = re.findall(r'^#include "(\w+)\.hpp"', (SOURCE / f"{header}.hpp").read_text(), re.MULTILINE)
    return {header}.union(*map(included, names))
