"""A clip of tier exact on disk: a folder with its request and the frames that are computed.

``job.json`` is an ``AcceptedClip``, ``clip.bin`` the CLIP message (docs/reference/wire.md) that asks for the clip, and
``frame-00012.npz`` a frame with its figures. All are written whole or not at all. The service that computes the clip
holds a lock on the folder, which ends with its process.
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
MOST_FRAMES = 100_000  # the most frames that a stored record may name
ABOUT, CLIP, LOCK = "job.json", "clip.bin", "lock"
COUNTS = ("crossings", "start_crossings", "steps")
FIGURES = ("force_share", "depth_m", "energy_j", "start_j", *COUNTS)


@dataclass(frozen=True)
class AcceptedClip:
    """The record of an accepted clip: its job's id and name, the key that sent it (``owner``), its number of frames,
    how often its computing was begun (``attempts``), and the problem document of the refusal that ended it, if one
    did."""

    id: str
    name: str
    owner: str | None
    frames: Annotated[int, Field(ge=1, le=MOST_FRAMES)]
    attempts: int = 0
    problem: dict[str, Any] | None = None

    def add_attempt(self, folder: Path) -> AcceptedClip:
        """Returns this record with one more of ``attempts``, and writes that to ``folder``."""
        again = replace(self, attempts=self.attempts + 1)
        again.write(folder)
        return again

    def write(self, folder: Path) -> None:
        """Writes the record to ``folder``, where ``read_accepted`` reads it."""
        with whole_file(folder / ABOUT) as stream:
            stream.write(json.dumps(asdict(self)).encode())


def read_accepted(folder: Path) -> AcceptedClip | None:
    """Returns the record in ``folder``. None if there is none, if the folder is not named by its id, or if the request
    is missing though no problem has ended the clip."""
    accepted = read_record(AcceptedClip, folder / ABOUT)
    if accepted is None:
        return None
    complete = accepted.problem is not None or (folder / CLIP).is_file()
    return accepted if folder.name == accepted.id and complete else None


def frame_path(folder: Path, number: int) -> Path:
    """Returns the path of the file of the frame ``number`` (from 0) of the clip in ``folder``."""
    return folder / f"frame-{number:05d}.npz"


def write_frame(folder: Path, number: int, x: np.ndarray, figures: dict[str, Any]) -> None:
    """Writes the frame ``number`` to its file: vertices ``x`` [m] (V, 3) float32, relative to the root joint in the
    world's axes, and ``figures``, whose keys are ``FIGURES`` (each explained by ``FrameTold``)."""
    with whole_file(frame_path(folder, number)) as stream:
        np.savez(stream, x=x, told=np.array([figures[name] for name in FIGURES], np.float64))


def read_frame(folder: Path, number: int) -> tuple[np.ndarray, dict[str, Any]] | None:
    """Returns the vertices [m] (V, 3) float32 and the figures of the frame ``number``, as ``write_frame`` wrote them;
    None if there is no whole file of it."""
    go_on()
    try:
        with np.load(frame_path(folder, number), allow_pickle=False) as stored:
            x, figures = stored["x"], dict[str, Any](zip(FIGURES, stored["told"].tolist(), strict=True))
            whole = x.ndim == 2 and x.shape[1] == 3 and np.isfinite(x).all()
            return (x, figures | {name: int(figures[name]) for name in COUNTS}) if whole else None
    except (*UNREADABLE, OverflowError):
        return None


def folders(root: Path) -> Iterator[Path]:
    """Yields the folders of all clips under ``root``, the oldest first."""
    yield from sorted((root / FOLDER).glob("*/"), key=lambda folder: folder.stat().st_mtime)


def stored_bytes(root: Path) -> int:
    """Returns the bytes of all files of clips under ``root``."""
    total = 0
    for path in (root / FOLDER).glob("*/*"):
        try:
            total += path.stat().st_size
        except FileNotFoundError:  # removed meanwhile
            continue
    return total


def clear_clip(folder: Path) -> None:
    """Deletes the request and the frames of the clip in ``folder``. Its record stays for clients that ask later."""
    for path in folder.glob("*"):
        if path.name not in (ABOUT, LOCK):
            path.unlink(missing_ok=True)


def remove_clip(folder: Path) -> None:
    """Deletes ``folder``, that of a clip."""
    shutil.rmtree(folder, ignore_errors=True)


class Lock:
    """A lock on the clip in ``folder``, which one process at a time can hold. ``held`` says whether this one got it."""

    def __init__(self, folder: Path) -> None:
        self._file = os.open(folder / LOCK, os.O_CREAT | os.O_RDWR)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.held = True
        except OSError:
            self.held = False
            self.release()

    def release(self) -> None:
        """Gives the lock up, so that another process can get it."""
        if self._file >= 0:
            os.close(self._file)
        self._file = -1
