"""Prints the test files that changed files reach, the nearest first: ``make quick`` runs them.

    python scripts/quick.py [BASE]

A file counts as changed if it differs from the commit BASE, by default HEAD, or the one before where nothing differs
from HEAD. A test file is as far from a changed module as imports are: it imports that, or what imports it.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from itertools import takewhile
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("drape", "training", "model_export", "service", "clients", "recovery", "benchmarks")
# Files that are no modules, by the modules or tests that read them.
ENGINE, ENGINE_MODULE = "drape/engine/source/", "drape.engine.calls"
READERS = {"clients/web/": "tests/clients", "docs/": "tests/architecture", "deploy/": "tests/architecture"}


def changed_files(base: str | None) -> list[str]:
    """Returns the paths, relative to the root, of files that differ from the commit ``base`` and of new files that git
    does not track yet. Where ``base`` is None it is HEAD, or the commit before where nothing differs from HEAD."""
    new = _git("ls-files", "--others", "--exclude-standard")
    if base is not None:
        return [*_git("diff", "--name-only", base), *new]
    return [*_git("diff", "--name-only", "HEAD"), *new] or _git("diff", "--name-only", "HEAD~1")


def _git(*command: str) -> list[str]:
    return subprocess.run(["git", *command], cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()


def module_of(path: str) -> str | None:
    """Returns the dotted name of the Python module in the file ``path``; of a source of the engine, the module that
    calls it; of any other file None."""
    if path.startswith(ENGINE):
        return ENGINE_MODULE
    if not path.endswith(".py"):
        return None
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def import_distances(graph: grimp.ImportGraph, modules: Iterable[str]) -> dict[str, int]:
    """Returns, for each module of ``graph`` that imports one of ``modules`` directly or through others, the number of
    imports in the shortest chain to any of them; 0 for ``modules`` themselves."""
    steps = {module: 0 for module in modules if module in graph.modules}
    last, far = set(steps), 0
    while last:
        far += 1
        last = {user for module in last for user in graph.find_modules_that_directly_import(module)} - steps.keys()
        steps |= dict.fromkeys(last, far)
    return steps


@cache
def imports_of(path: Path) -> frozenset[str]:
    """Returns the names of the modules that the test file ``path`` imports, directly or through modules of tests/. A
    name that is imported from a module counts as a module too."""
    modules: set[str] = set()
    for module in _imported(ast.parse(path.read_text(encoding="utf-8"))):
        modules.add(module)
        helper = ROOT / (module.replace(".", "/") + ".py")
        if module.startswith("tests.") and helper.is_file() and helper != path:
            modules |= imports_of(helper)
    return frozenset(modules)


def _imported(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module
            yield from (f"{node.module}.{name.name}" for name in node.names)


def reached_tests(changed: list[str]) -> list[str]:
    """Returns the paths of the test files that a change of the files ``changed`` may break, the nearest first: by
    imports, by the name of the file, or by the folders of ``READERS``."""
    modules = {module for path in changed if (module := module_of(path))}
    far = import_distances(grimp.build_graph(*PACKAGES), modules)
    stems = {Path(path).stem for path in changed}
    folders = {folder for path in changed for prefix, folder in READERS.items() if path.startswith(prefix)}
    rank: dict[str, tuple[float, int]] = {}
    for test in sorted((ROOT / "tests").rglob("test_*.py")):
        path = test.relative_to(ROOT).as_posix()
        near = [far[module] + 1.0 for module in imports_of(test) if module in far]
        near += [1.0 for module in imports_of(test) if module in modules]  # helpers of tests
        if path in changed:
            near.append(0.0)
        if test.stem.removeprefix("test_") in stems or any(path.startswith(folder + "/") for folder in folders):
            near.append(0.5)
        if near:
            rank[path] = min(near), -max(_shared(path.removeprefix("tests/"), other) for other in changed)
    return sorted(rank, key=rank.__getitem__)


def _shared(path: str, other: str) -> int:
    """Returns how many leading parts two paths have in common."""
    return len(list(takewhile(lambda pair: pair[0] == pair[1], zip(Path(path).parts, Path(other).parts, strict=False))))


def main() -> None:
    """Prints the test files that the changed files reach, one a line; the first argument is the commit BASE."""
    print(*reached_tests(changed_files(sys.argv[1] if len(sys.argv) > 1 else None)), sep="\n")


if __name__ == "__main__":
    main()
