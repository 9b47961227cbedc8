"""Accepted uploads on disk, which outlive the process: each is a folder with its file and ``job.json``.

The folder lies in the staging folder of the service that has the upload. That is named by host and process id, so that
other services can take over uploads of a process that has ended. One on another host counts as ended when it has not
touched its folder for ``SILENT_S``.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import time
import uuid
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from service.compute.json_records import read_record

Kind = Literal["garment", "avatar"]
ABOUT = "job.json"
STAGING = ".staging-"
UNREADABLE = "unreadable-uploads"
CANCEL = "cancel"  # a file in an upload's folder by which another service asks to cancel it
SILENT_S = 120.0
_OWN: set[str] = set()  # the names of the staging folders of services in this process


def staging_folder(root: Path) -> Path:
    """Returns a new path under ``root`` for the staging folder of a service in this process. It does not exist yet."""
    folder = root / f"{STAGING}{uuid.uuid4().hex[:8]}-{_host()}-{os.getpid()}"
    _OWN.add(folder.name)
    return folder


def _host() -> str:
    return socket.gethostname().replace("-", "_")


@dataclass(frozen=True)
class Accepted:
    """The record of an accepted upload: its job's id and name, the key that sent it (``owner``), the name of its
    ``file``, and how often its intake was begun (``attempts``).

    ``avatar``, of a garment: the body that it was modelled on, None where the intake shall find it; of an avatar: the
    joints and parts that a client named and whether its clothes become garments, as JSON, None if nothing was said.
    ``replaces``: the id of the avatar that it corrects.
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
        """Writes the record to ``folder``. It is on disk when this returns."""
        fresh = folder / f"{ABOUT}.new"
        fresh.write_text(json.dumps(asdict(self)), encoding="utf-8")
        sync(fresh)
        os.replace(fresh, folder / ABOUT)
        sync(folder)
        sync(folder.parent)

    def add_attempt(self, folder: Path) -> Accepted:
        """Adds one to ``attempts``, writes the record to ``folder`` and returns it."""
        again = replace(self, attempts=self.attempts + 1)
        again.write(folder)
        return again


def sync(path: Path) -> None:
    """Writes the file or folder ``path`` from the system's buffers to the disk (fsync)."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def take_over(root: Path, own: Path, *, shared: bool = False) -> Iterator[tuple[Accepted, Path]]:
    """Moves the uploads of ended processes under ``root`` to the staging folder ``own``, and deletes their other files.
    Yields each upload and its new folder, the oldest first. Uploads whose records cannot be read, as those of another
    version, go to the folder ``UNREADABLE`` in ``root``.

    ``shared``: services on other hosts use ``root`` too, and call ``touch`` every few seconds while they run.
    """
    ended = [staging for staging in sorted(root.glob(f"{STAGING}*")) if staging != own and _ended(staging, shared)]
    uploads: list[tuple[float, Accepted, Path]] = []
    for folder in sorted(path for staging in ended for path in staging.glob("*/")):
        accepted = read_accepted(folder)
        if accepted is not None:
            uploads.append(((folder / accepted.file).stat().st_mtime, accepted, folder))
        elif (folder / ABOUT).exists():
            _set_aside(folder, root / UNREADABLE)
    for _, accepted, folder in sorted(uploads, key=lambda upload: upload[0]):
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


def _set_aside(folder: Path, home: Path) -> None:
    home.mkdir(exist_ok=True)
    with suppress(OSError):  # another service was faster, or one of this name is there
        os.rename(folder, home / folder.name)


def touch(own: Path) -> None:
    """Sets the time of the staging folder ``own`` to now, by which other services see that this one still runs."""
    if own.is_dir():
        os.utime(own)


def find_elsewhere(root: Path, own: Path, job_id: str) -> tuple[Accepted, Path] | None:
    """Returns the upload ``job_id`` and its folder if it waits or runs in another service that uses ``root``; otherwise
    None. ``own`` is the staging folder of this service."""
    for folder in root.glob(f"{STAGING}*/{job_id}"):
        accepted = None if folder.parent == own else read_accepted(folder)
        if accepted is not None:
            return accepted, folder
    return None


def read_accepted(folder: Path) -> Accepted | None:
    """Returns the record in ``folder``; None if there is none, if the folder is not named by its id, or if its file is
    missing."""
    accepted = read_record(Accepted, folder / ABOUT)
    complete = accepted is not None and folder.name == accepted.id and (folder / accepted.file).is_file()
    return accepted if complete else None


def _ended(staging: Path, shared: bool) -> bool:
    if staging.name in _OWN:
        return False
    before, _, pid = staging.name.removeprefix(STAGING).rpartition("-")
    host = before.rpartition("-")[2]
    if host in ("", _host()):  # earlier versions wrote no host
        # A folder with this process's id that is not in _OWN is of an earlier process: containers reuse ids.
        return pid == str(os.getpid()) or not _is_running(pid)
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
