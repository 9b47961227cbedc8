"""Uploads that were accepted outlive the process: each is a folder with its file and ``job.json``, both on disk.

The folder lies in the staging folder of the process that has it, which is named by its host and number; others take
over those of ended ones. A process on another host counts as ended when it has been silent for ``SILENT_S``.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import time
import uuid
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from service.compute.json_records import read_record

Kind = Literal["garment", "avatar"]
ABOUT = "job.json"
STAGING = ".staging-"
CANCEL = "cancel"  # in an upload's folder: another service was asked to end it
SILENT_S = 120.0


_OWN: set[str] = set()  # names of staging folders of services in this process


def staging_folder(root: Path) -> Path:
    """A new place under ``root`` for the uploads of a service in this process."""
    folder = root / f"{STAGING}{uuid.uuid4().hex[:8]}-{_host()}-{os.getpid()}"
    _OWN.add(folder.name)
    return folder


def _host() -> str:
    return socket.gethostname().replace("-", "_")


@dataclass(frozen=True)
class Accepted:
    """An accepted upload: its job's id and name, its key, its file's name, its avatar, how often it ran, what ``kind``
    of thing it is, "garment" or "avatar", and which avatar it replaces.

    ``avatar``: of a garment, what it was modelled on; of an avatar, the joints that were told, as JSON.
    """

    id: str
    name: str
    owner: str | None
    file: Annotated[str, Field(pattern=r"^[^/\x00]{1,200}$")]
    avatar: str | None
    attempts: int = 0
    kind: Kind = "garment"
    replaces: str | None = None

    def write(self, folder: Path) -> None:
        """Puts it into ``folder``, on disk when this returns."""
        fresh = folder / f"{ABOUT}.new"
        fresh.write_text(json.dumps(asdict(self)), encoding="utf-8")
        sync(fresh)
        os.replace(fresh, folder / ABOUT)
        sync(folder)
        sync(folder.parent)

    def tried(self, folder: Path) -> Accepted:
        """Returns the same upload with one attempt more, after writing it to ``folder``."""
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


def taken_over(root: Path, own: Path, *, shared: bool = False) -> Iterator[tuple[Accepted, Path]]:
    """The uploads that ended processes left under ``root``, now in the staging folder ``own``, the oldest first; what
    else they left is removed.

    ``shared``: services on other hosts have the folder too, and say every few seconds that they run (``touch``).
    """
    ended = [staging for staging in sorted(root.glob(f"{STAGING}*")) if staging != own and _ended(staging, shared)]
    left: list[tuple[float, Accepted, Path]] = []
    for folder in sorted(path for staging in ended for path in staging.glob("*/")):
        accepted = read(folder)
        if accepted is not None:
            left.append(((folder / accepted.file).stat().st_mtime, accepted, folder))
    for _, accepted, folder in sorted(left, key=lambda one: one[0]):
        home = own / accepted.id
        own.mkdir(exist_ok=True)
        try:
            os.rename(folder, home)
        except FileNotFoundError:  # another service was faster
            continue
        shutil.rmtree(home / "out", ignore_errors=True)
        yield accepted, home
    for staging in ended:
        shutil.rmtree(staging, ignore_errors=True)


def touch(own: Path) -> None:
    """Gives the staging folder ``own`` the time of now, which tells other services that its process still runs."""
    if own.is_dir():
        os.utime(own)


def elsewhere(root: Path, own: Path, job_id: str) -> tuple[Accepted, Path] | None:
    """Returns the upload ``job_id`` and its folder, if it waits or runs in another service under ``root``; otherwise
    None."""
    for folder in root.glob(f"{STAGING}*/{job_id}"):
        accepted = None if folder.parent == own else read(folder)
        if accepted is not None:
            return accepted, folder
    return None


def read(folder: Path) -> Accepted | None:
    """The upload that was accepted in ``folder``, if one was."""
    accepted = read_record(Accepted, folder / ABOUT)
    known = accepted is not None and folder.name == accepted.id and (folder / accepted.file).is_file()
    return accepted if known else None


def _ended(staging: Path, shared: bool) -> bool:
    if staging.name in _OWN:
        return False
    before, _, pid = staging.name.removeprefix(STAGING).rpartition("-")
    host = before.rpartition("-")[2]
    if host in ("", _host()):  # without one: of an earlier version
        return pid == str(os.getpid()) or not _is_running(pid)  # mine: in a container numbers come again
    try:
        return not shared or time.time() - staging.stat().st_mtime > SILENT_S
    except FileNotFoundError:
        return False


def _is_running(pid: str) -> bool:
    try:
        os.kill(int(pid), 0)
    except (ValueError, ProcessLookupError):
        return False
    except PermissionError:
        return True
    return True
