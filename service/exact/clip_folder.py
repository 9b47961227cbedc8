"""A clip of tier exact on disk, a folder: what was asked for, and its frames as they come.

``job.json`` tells whose it is, ``clip.bin`` is the CLIP message (docs/reference/wire.md) that asks for it, and
``frame-00012.npz`` a frame with what is told of it. All are written whole or not at all. The process that computes the
clip holds a lock on the folder, which ends with that process.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from drape.files.atomic import whole_file
from drape.files.packed import UNREADABLE
from drape.wanted import go_on
from service.compute.json_records import read_record

FOLDER = ".clips"
MOST_FRAMES = 100_000  # that a stored clip may say it has
ABOUT, CLIP, LOCK = "job.json", "clip.bin", "lock"
COUNTS = ("crossings", "start_crossings", "steps")
FIGURES = ("force_share", "depth_m", "energy_j", "start_j", *COUNTS)


@dataclass(frozen=True)
class AcceptedClip:
    """An accepted clip: its job's id and name, its key, its number of frames, how often it was begun, and the
    ``problem`` that ended it."""

    id: str
    name: str
    owner: str | None
    frames: Annotated[int, Field(ge=1, le=MOST_FRAMES)]
    attempts: int = 0
    problem: dict[str, Any] | None = None

    def tried(self, folder: Path) -> AcceptedClip:
        """Returns the clip with one attempt more, written to ``folder``."""
        again = replace(self, attempts=self.attempts + 1)
        again.write(folder)
        return again

    def write(self, folder: Path) -> None:
        """Writes what was accepted to ``folder``, as ``read_accepted`` reads it."""
        with whole_file(folder / ABOUT) as stream:
            stream.write(json.dumps(asdict(self)).encode())


def read_accepted(folder: Path) -> AcceptedClip | None:
    """The clip that was accepted in ``folder``, if one was."""
    accepted = read_record(AcceptedClip, folder / ABOUT)
    if accepted is None:
        return None
    known = accepted.problem is not None or (folder / CLIP).is_file()
    return accepted if folder.name == accepted.id and known else None


def frame_path(folder: Path, number: int) -> Path:
    """The file of a frame."""
    return folder / f"frame-{number:05d}.npz"


def write_frame(folder: Path, number: int, x: np.ndarray, told: dict[str, Any]) -> None:
    """Stores the vertices ``x`` [m] (V, 3) float32 of a frame, relative to the root, and what is ``told`` of it."""
    with whole_file(frame_path(folder, number)) as stream:
        np.savez(stream, x=x, told=np.array([told[name] for name in FIGURES], np.float64))


def read_frame(folder: Path, number: int) -> tuple[np.ndarray, dict[str, Any]] | None:
    """Returns the vertices [m] (V, 3) of a frame and what was told of it, as ``write_frame`` stored them; None where
    there is no such frame.
    """
    go_on()
    try:
        with np.load(frame_path(folder, number), allow_pickle=False) as stored:
            x, told = stored["x"], dict[str, Any](zip(FIGURES, stored["told"].tolist(), strict=True))
            whole = x.ndim == 2 and x.shape[1] == 3 and np.isfinite(x).all()
            return (x, told | {name: int(told[name]) for name in COUNTS}) if whole else None
    except (*UNREADABLE, OverflowError):
        return None


def folders(root: Path) -> Iterator[Path]:
    """The folders of all clips under ``root``, the oldest first."""
    yield from sorted((root / FOLDER).glob("*/"), key=lambda one: one.stat().st_mtime)


def stored_bytes(root: Path) -> int:
    """Bytes of all clips under ``root``."""
    total = 0
    for path in (root / FOLDER).glob("*/*"):
        try:
            total += path.stat().st_size
        except FileNotFoundError:  # removed meanwhile
            continue
    return total


def clear_clip(folder: Path) -> None:
    """Removes the request and the computed frames of a clip from the disk. Its record stays, for clients that ask
    later."""
    for path in folder.glob("*"):
        if path.name not in (ABOUT, LOCK):
            path.unlink(missing_ok=True)


def remove_clip(folder: Path) -> None:
    """Takes a clip off the disk."""
    shutil.rmtree(folder, ignore_errors=True)


class Lock:
    """The right to compute the clip in ``folder``, of one process at a time."""

    def __init__(self, folder: Path) -> None:
        self._file = os.open(folder / LOCK, os.O_CREAT | os.O_RDWR)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.held = True
        except OSError:
            self.held = False
            self.release()

    def release(self) -> None:
        """Gives the claim up, so that another process may take it."""
        if self._file >= 0:
            os.close(self._file)
        self._file = -1
