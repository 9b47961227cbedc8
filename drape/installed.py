"""Checks that an installation is whole and runs on this processor, before commands import NumPy.

An installation that was interrupted lacks files, or has cut ones: a library that was cut ends the process when it is
loaded. NumPy ends it on a processor that it was not built for.
"""

from __future__ import annotations

import csv
from contextlib import suppress
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from drape.engine.probe import processor_level
from drape.errors import ArtifactError

NAMES = ("patchdrape", *(f"patchdrape-{member}" for member in ("service", "client", "recovery", "training", "export")))
AGAIN = "Install the same wheels again, with --force-reinstall."


def check() -> None:
    """Refuses (``ArtifactError``) an installation that is not whole, and a processor that is too old for it."""
    for name in NAMES:
        with suppress(PackageNotFoundError):
            check_whole(distribution(name))
    check_processor(processor_level()[0])


def check_processor(level: int) -> None:
    """Refuses (``ArtifactError``) ``level`` 1, the lowest of x86-64. Processors of other kinds have level 0 and
    pass."""
    if level == 1:
        cure = "Use a processor of 2009 or later; an emulator may be told to be one."
        raise ArtifactError("processor", expected="x86-64 of level v2, v3 or v4", got="v1", cure=cure)


def check_whole(installed: Distribution) -> None:
    """Refuses (``ArtifactError``) the distribution ``installed`` if a file of its packages is missing.

    A file of data or machine code must also have the size that the wheel says; Python may be changed where it lies. A
    distribution that was installed from a clone has no such files and passes.
    """
    broken, place = [], Path(str(installed.locate_file("")))
    for name, _, size in csv.reader((installed.read_text("RECORD") or "").splitlines()):
        first, own_size = name.partition("/")[0], _size(place / name)
        apart = not size or first == ".." or first.endswith((".pth", ".dist-info"))  # files of the installer
        if not apart and own_size != int(size) and (own_size < 0 or not name.endswith(".py")):
            broken.append(name)
    if broken:
        more = f", and {len(broken) - 1} more" if len(broken) > 1 else ""
        got = f"{broken[0]} missing or cut{more}"
        raise ArtifactError("installation", expected="every file as it was packed", got=got, cure=AGAIN)


def _size(path: Path) -> int:
    """The size of the file [bytes], -1 where there is none."""
    try:
        return path.stat().st_size
    except OSError:
        return -1
