"""Records of ended uploads on disk, a file for each, which clients ask for later and services of one folder share."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from service.compute import json_records
from service.compute.garment_files import replace_text

FOLDER = ".jobs"
KEPT = 256
Outcome = Literal["done", "failed", "cancelled"]


@dataclass(frozen=True)
class JobRecord:
    """An upload that has ended: fields of its ``JobInfo``, and the key that sent it (``owner``).

    ``garment`` is the id of the outermost garment, ``garments`` has all ids, the innermost first. ``avatar`` is the id
    of an uploaded character. ``problem`` is the problem document of a failed upload. ``wearer`` is the body that the
    intake found from the cloth, with the fields of ``WearerFound``.
    """

    id: str
    name: str
    owner: str | None
    state: Outcome
    garment: str | None = None
    problem: dict[str, Any] | None = None
    avatar: str | None = None
    notes: Sequence[str] = ()
    garments: Sequence[str] = ()
    wearer: dict[str, Any] | None = None

    def write(self, root: Path) -> None:
        """Writes the record under ``root``, and deletes the oldest records beyond ``KEPT``."""
        folder = root / FOLDER
        folder.mkdir(exist_ok=True)
        replace_text(_path(root, self.id), json.dumps(asdict(self)))
        times: list[tuple[int, Path]] = []
        for path in folder.glob("*.json"):
            try:
                times.append((path.stat().st_mtime_ns, path))
            except FileNotFoundError:  # removed by another service
                continue
        for _, path in sorted(times)[:-KEPT]:
            path.unlink(missing_ok=True)


def read_job_record(root: Path, job_id: str) -> JobRecord | None:
    """Returns the record of the upload ``job_id`` under ``root``. None if there is none, or if it cannot be read or
    does not fit, which is logged."""
    return json_records.read_record(JobRecord, _path(root, job_id))


def remove_record(root: Path, job_id: str) -> None:
    """Deletes the record of the upload ``job_id`` under ``root``, if there is one."""
    _path(root, job_id).unlink(missing_ok=True)


def _path(root: Path, job_id: str) -> Path:
    return root / FOLDER / f"{job_id}.json"
