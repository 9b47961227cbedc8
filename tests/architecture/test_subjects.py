"""A function does one thing and a file has one subject: few operands each, few public names each."""

from __future__ import annotations

import ast
from pathlib import Path

from tests.architecture.repository import PACKAGES, ROOT, repository_files

MOST_OPERANDS = 7  # of a function, without self and what is given by keyword alone
MOST_NAMES = 24  # functions and classes that a module shows; a table of calls has most


def operands(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Parameters of ``node`` that may be given by position, without self or cls."""
    names = [argument.arg for argument in (*node.args.posonlyargs, *node.args.args)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def crowded(path: Path, source: str) -> list[str]:
    """Functions of too many operands in ``source`` of the file ``path``, and too many public names."""
    tree = ast.parse(source)
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    found = [f"{path}: {f.name} takes {operands(f)}" for f in functions if operands(f) > MOST_OPERANDS]
    shown = [n for n in tree.body if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)]
    names = [node.name for node in shown if not node.name.startswith("_")]
    if path.parts[0] in PACKAGES and len(names) > MOST_NAMES:
        found.append(f"{path}: {len(names)} public names")
    return found


def test_functions_take_few_operands_and_modules_show_few_names():
    paths = [path for path in repository_files() if path.suffix == ".py"]
    assert len(paths) > 100
    found = [item for path in paths for item in crowded(path.relative_to(ROOT), path.read_text(encoding="utf-8"))]
    assert found == []
