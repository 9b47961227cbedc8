"""Files that another file names, in its folder."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path


def file_beside(folder: Path | None, wanted: str, *, most_bytes: int) -> bytes | None:
    """Returns the bytes of the file ``wanted`` in or below ``folder``; None where it is not there, or has more than
    ``most_bytes``."""
    if folder is None:
        return None
    path = folder / wanted.replace("\\", "/")
    with suppress(OSError, ValueError):  # A stranger's name may be no valid path.
        if path.resolve().is_relative_to(folder.resolve()) and path.stat().st_size <= most_bytes:
            return path.read_bytes()
    return None
