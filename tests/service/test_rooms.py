"""The rooms of the service: imports point one way between them, the application alone knows the replicas, and a pose
enters few files."""

from __future__ import annotations

import ast
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import numpy as np

import service
from service.settings import Settings
from tests.fixtures.serving import served
from tests.fixtures.streams import raw_stream

ROOT = Path(service.__file__).parent
# A room may import those before it. Files beside the folders are rooms of their own; ``app`` stands above all folders.
ORDER = ("errors", "settings", "watch", "compute", "guard", "state", "uploads", "exact", "http", "stream")
ABOVE = ("server", "app", "ray_app", "keys", "static", "__main__")
# Files whose code runs between a pose's coming and its frame's leaving: fourteen that make the frame, four that watch.
ROAD = {
    *("service/stream/routes.py", "service/stream/session.py", "service/stream/workers.py"),
    *("service/compute/drape_runtime.py", "service/compute/threads.py"),
    *("drape/stages/batch.py", "drape/stages/stage.py", "drape/stages/walk.py", "drape/stages/frame.py"),
    *("drape/stages/network.py", "drape/inference/packing.py"),
    *("drape/stages/swing.py", "drape/stages/folds.py", "drape/stages/encode.py"),
    *("service/watch/logs.py", "service/watch/prometheus.py", "service/watch/turns.py", "service/watch/watchdog.py"),
}
ALONG = tuple(f"{ROOT.parent}/{room}/" for room in ("service", "drape/stages", "drape/inference"))


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


def test_a_pose_enters_few_files(make_settings: Callable[..., Settings]):
    entered: set[str] = set()

    def look(frame: FrameType, event: str, argument: object) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(ALONG):
            entered.add(frame.f_code.co_filename.removeprefix(f"{ROOT.parent}/"))

    threading.setprofile(look)  # for threads that begin now: those of the service
    try:
        with served(make_settings(folds=1, inertia="mesh")) as url:
            found = entered_by_poses(url, entered)
    finally:
        threading.setprofile(None)  # pyright: ignore[reportArgumentType]
    assert found == ROAD, sorted(found ^ ROAD)


def entered_by_poses(url: str, entered: set[str]) -> set[str]:
    """Of the files that come into ``entered`` those that each pose of a plain stream enters, past its beginning."""
    found = []
    with raw_stream(url) as stream:
        assert stream.open(garment="tube", tier="balanced")["type"] == "opened"
        for i in range(1, 11):
            entered.clear()
            stream.message(i, np.full((24, 3), 0.01 * i), time_s=i / 30.0)
            time.sleep(0.02)  # until the acknowledgement is taken
            found.append(set(entered))
    return set.intersection(*found[4:])
