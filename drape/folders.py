"""Where files lie: what the product ships, and what its users make."""

from __future__ import annotations

import os
from importlib.resources import files
from pathlib import Path

ASSETS = Path(str(files("drape"))) / "assets"
"""The shipped model, body, garments and clips."""


def clone_around(package: Path) -> Path | None:
    """Returns the folder of the clone that the folder ``package`` lies in; None where it is installed by a wheel."""
    return package.parent if (package.parent / "pyproject.toml").is_file() else None


def data_home() -> Path:
    """Returns the folder for the files of users where there is no clone: ``drape`` in XDG_DATA_HOME, by default in
    ``~/.local/share``, on Windows in LOCALAPPDATA."""
    named = os.environ.get("LOCALAPPDATA" if os.name == "nt" else "XDG_DATA_HOME", "")
    return (Path(named) if Path(named).is_absolute() else _home() / ".local" / "share") / "drape"


def _home() -> Path:
    """The user's home. A user whom the machine does not know has none, and gets a folder in which nothing can be
    written."""
    try:
        return Path.home()
    except RuntimeError:
        return Path("/nonexistent")


CLONE = clone_around(ASSETS.parent)
RUNS = CLONE / "runs" if CLONE else data_home()
"""What users make: garments, recoveries, training."""
