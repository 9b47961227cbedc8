"""Words that readers cannot do without: nouns for values that live long, shapes of arrays that come back."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from tests.architecture.repository import PACKAGES, ROOT

PARTICIPLES = frozenset({"made", "told", "lain", "taken", "found", "each", "one"})
SHORT = 3  # lines from first to last use: so long a reader still sees where a value came from
ARRAYS = re.compile(r"^(tuple\[)?(np\.ndarray(, )?)+\]?$")
SHAPE = re.compile(r"\(([^()]*(, ?\w+|,)|[A-Z0-9][^()]*)\)|shape|Returns ``\w+``|of this ``\w+``")

Function = ast.FunctionDef | ast.AsyncFunctionDef


def functions() -> Iterator[tuple[str, Function]]:
    """Every function of the product, with its file and line."""
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py") if package != "tests" else ():
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, Function):
                    yield f"{path.relative_to(ROOT)}:{node.lineno} {node.name}", node


def uses(function: Function) -> Iterator[tuple[str, int]]:
    """The names of ``function``'s parameters and values, with the lines that use them."""
    parameters = function.args
    for parameter in (*parameters.posonlyargs, *parameters.args, *parameters.kwonlyargs):
        yield parameter.arg, parameter.lineno
    yield from ((node.id, node.lineno) for node in ast.walk(function) if isinstance(node, ast.Name))


def long_participles(function: Function) -> set[str]:
    """The values of ``function`` that are named by a participle and live longer than ``SHORT`` lines."""
    lines: dict[str, list[int]] = {}
    for name, line in uses(function):
        lines.setdefault(name, []).append(line)
    return {name for name in PARTICIPLES & set(lines) if max(lines[name]) - min(lines[name]) > SHORT}


def test_values_that_live_long_are_named_by_nouns():
    assert {where: names for where, function in functions() if (names := long_participles(function))} == {}


def says_no_shape(function: Function) -> bool:
    """Whether ``function`` is public, returns arrays, and has a docstring that says no shape."""
    words = ast.get_docstring(function)
    if function.name.startswith("_") or words is None or function.returns is None:
        return False
    return ARRAYS.match(ast.unparse(function.returns)) is not None and SHAPE.search(words) is None


def test_what_returns_arrays_says_their_shape():
    assert [where for where, function in functions() if says_no_shape(function)] == []


def test_the_rules_find_what_breaks_them():
    tree = ast.parse("def f(x):\n    made = x\n    x = 1\n    x = 2\n    x = 3\n    return made")
    bad = ast.parse('def f(x) -> np.ndarray:\n    """The normals of all faces."""').body[0]
    good = ast.parse('def f(x) -> np.ndarray:\n    """The normals (F, 3) of all faces."""').body[0]
    assert isinstance(tree.body[0], Function) and isinstance(bad, Function) and isinstance(good, Function)
    assert long_participles(tree.body[0]) == {"made"}
    assert says_no_shape(bad) and not says_no_shape(good)
