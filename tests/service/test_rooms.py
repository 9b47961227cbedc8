"""The rooms of the service: imports point one way between them, and the application alone knows the replicas."""

from __future__ import annotations

import ast
from pathlib import Path

import service

ROOT = Path(service.__file__).parent
# A room may import those before it. Files beside the folders are rooms of their own; ``app`` stands above all folders.
ORDER = ("errors", "settings", "graphs", "stages", "watch", "compute", "guard", "state", "uploads", "http", "stream")
ABOVE = ("server", "app", "ray_app", "keys", "__main__")


def room(path: Path) -> str:
    return path.relative_to(ROOT).with_suffix("").parts[0]


def imported(path: Path) -> set[str]:
    """The rooms that ``path`` imports when it is loaded, so not for types alone."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    lines = [node for node in tree.body if isinstance(node, ast.ImportFrom) and node.module is not None]
    names = {f"{line.module}.{alias.name}" for line in lines for alias in line.names}
    return {name.split(".")[1] for name in names if name.startswith("service.")}


def test_rooms_import_those_before_them():
    known = {*ORDER, *ABOVE, "replicas", "__init__"}
    paths = [path for path in ROOT.rglob("*.py") if "__pycache__" not in path.parts]
    assert len(paths) > 60 and {room(path) for path in paths} <= known
    for path in paths:
        if room(path) in ORDER:
            later = {*ORDER[ORDER.index(room(path)) + 1 :], *ABOVE, "replicas"}
            assert not imported(path) & later, path


def test_the_application_alone_knows_the_replicas():
    known = {path.stem for path in ROOT.rglob("*.py") if "replicas" in imported(path) and room(path) != "replicas"}
    assert known == {"app", "ray_app"}
