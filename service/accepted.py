"""Uploads that were accepted outlive the process: each is a folder with its file and ``job.json``, both on disk.

The folder lies in the staging folder of the process that has it; one that starts takes over those of ended ones.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

ABOUT = "job.json"
STAGING = ".staging-"


@dataclass(frozen=True)
class Accepted:
    """What is kept of an upload: its job's id and name, its key, its file's name, its avatar, and how often it ran."""

    id: str
    name: str
    owner: str | None
    file: str
    avatar: str | None
    attempts: int = 0

    def write(self, folder: Path) -> None:
        """Puts it into ``folder``, on disk when this returns."""
        fresh = folder / f"{ABOUT}.new"
        fresh.write_text(json.dumps(asdict(self)), encoding="utf-8")
        sync(fresh)
        os.replace(fresh, folder / ABOUT)
        sync(folder)
        sync(folder.parent)

    def tried(self, folder: Path) -> Accepted:
        """The same with one attempt more, written."""
        again = replace(self, attempts=self.attempts + 1)
        again.write(folder)
        return again


def sync(path: Path) -> None:
    """Returns when the file or folder ``path`` is on disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def taken_over(root: Path, own: Path) -> Iterator[tuple[Accepted, Path]]:
    """The uploads that ended processes left under ``root``, now in the staging folder ``own``, the oldest first; what
    else they left is removed."""
    left: list[tuple[float, Accepted, Path]] = []
    for staging in sorted(root.glob(f"{STAGING}*")):
        if staging != own and _is_running(staging.name.removeprefix(STAGING)):
            continue
        for folder in sorted(path for path in staging.iterdir() if path.is_dir()):
            accepted = _read(folder)
            if accepted is not None:
                left.append(((folder / accepted.file).stat().st_mtime, accepted, folder))
            else:
                shutil.rmtree(folder, ignore_errors=True)
    for _, accepted, folder in sorted(left, key=lambda one: one[0]):
        home = own / accepted.id
        if folder != home:
            own.mkdir(exist_ok=True)
            os.rename(folder, home)
        shutil.rmtree(home / "out", ignore_errors=True)
        yield accepted, home
    for staging in root.glob(f"{STAGING}*"):
        if staging != own and not _is_running(staging.name.removeprefix(STAGING)):
            shutil.rmtree(staging, ignore_errors=True)


def _read(folder: Path) -> Accepted | None:
    try:
        accepted = Accepted(**json.loads((folder / ABOUT).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None
    return accepted if folder.name == accepted.id and (folder / accepted.file).is_file() else None


def _is_running(pid: str) -> bool:
    try:
        os.kill(int(pid), 0)
    except (ValueError, ProcessLookupError):
        return False
    except PermissionError:
        return True
    return True
