"""Where files lie: what the product ships, and what its users make."""

from __future__ import annotations

import os
from importlib.resources import files
from pathlib import Path

ASSETS = Path(str(files("drape"))) / "assets"
"""The shipped model, body, garments and clips."""


def clone_around(package: Path) -> Path | None:
    """The folder of the clone that the folder of a ``package`` lies in; None where it is installed by itself."""
    return package.parent if (package.parent / "pyproject.toml").is_file() else None


def data_home() -> Path:
    """The folder of what users make where there is no clone: ``drape`` in XDG_DATA_HOME, by default in
    ``~/.local/share``, on Windows in LOCALAPPDATA."""
    named = os.environ.get("LOCALAPPDATA" if os.name == "nt" else "XDG_DATA_HOME", "")
    return (Path(named) if Path(named).is_absolute() else _home() / ".local" / "share") / "drape"


def _home() -> Path:
    """The user's home. A user whom the machine does not know has none: nothing can be written there, and what tries
    says so."""
    try:
        return Path.home()
    except RuntimeError:
        return Path("/nonexistent")


CLONE = clone_around(ASSETS.parent)
RUNS = CLONE / "runs" if CLONE else data_home()
"""What users make: garments, recoveries, training."""
