"""The rule that finds a garment's avatar by its file name: ``avatars.json`` maps beginnings of names to avatars.

An entry is a phenotype or SMPL parameters (an object), ``standard``, or a mesh file beside the
table. Intake, service and clients ask the same rule; the shipped table knows ``female`` and
``male``, anny's neutral young adults.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from drape.errors import BodyError
from drape.folders import ASSETS

TABLE_NAME = "avatars.json"
SHIPPED_FOLDER = ASSETS / "bodies"


def avatar_table(folder: Path) -> dict[str, Any]:
    """Returns ``avatars.json`` of ``folder``: by the beginnings of the names of garment files, the avatars that they
    were modelled on. Empty where there is no such file.

    An avatar is an object (a phenotype or SMPL parameters), "standard", or the name of a mesh file beside the table.
    Raises ``BodyError`` for other content.
    """
    path = folder / TABLE_NAME
    if not path.is_file():
        return {}
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise BodyError(TABLE_NAME, expected="JSON", got=str(error), cure="Repair the file.") from error
    if not isinstance(table, dict) or not all(isinstance(entry, (dict, str)) for entry in table.values()):
        raise BodyError(
            TABLE_NAME,
            expected="names with their avatars",
            got=type(table).__name__,
            cure="See docs/guide/garments.md.",
        )
    return table


def entry_for(name: str, folders: list[Path]) -> tuple[str, Any, Path] | None:
    """Returns the key and the avatar that a table (``avatar_table``) has for the garment file ``name``, and the table's
    folder; None where no table of ``folders`` has one.

    A key fits where the name begins with it. The first folder that has such a key decides, by its longest one.
    """
    for folder in folders:
        table = avatar_table(folder)
        fitting = [key for key in table if name.startswith(key)]
        if fitting:
            key = max(fitting, key=len)
            return key, table[key], folder
    return None
