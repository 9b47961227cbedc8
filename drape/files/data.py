"""The folder of data outside the repository, which DRAPE_DATA names (docs/guide/data.md)."""

from __future__ import annotations

import os
from pathlib import Path

from drape.errors import NotFound

__all__ = ["DATA_VARIABLE", "HOW_TO_SET_DATA", "data_folder"]

DATA_VARIABLE = "DRAPE_DATA"
HOW_TO_SET_DATA = (
    f"Set {DATA_VARIABLE} to a folder of your own data, for example `export {DATA_VARIABLE}=$HOME/drape-data`; "
    "docs/guide/data.md says what goes there and where it can be had."
)


def data_folder(kind: str | None = None) -> Path | None:
    """Returns the folder named by DRAPE_DATA, or its subfolder ``kind`` ("garments", "motions", ...); None where the
    variable is not set, or there is no such subfolder.

    A variable that names nothing is refused (``NotFound``) rather than ignored: a mistyped path would otherwise look
    like a machine without data.
    """
    value = os.environ.get(DATA_VARIABLE, "").strip()
    if not value:
        return None
    folder = Path(value).expanduser()
    if not folder.is_dir():
        raise NotFound(DATA_VARIABLE, expected="an existing folder", got=value, cure=HOW_TO_SET_DATA)
    if kind is None:
        return folder
    return folder / kind if (folder / kind).is_dir() else None
