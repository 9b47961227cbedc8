"""Which avatar an upload was modelled on: what the client says, or the rule of avatars.json for its name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from drape.errors import BodyError, NotFound
from drape.files.avatar_table import SHIPPED_FOLDER, avatar_table, entry_for
from drape.files.data import data_folder
from drape.garment.avatars import STANDARD

MOST_CHARACTERS = 10_000  # SMPL parameters with every digit take 2,000
EXAMPLE = 'Send for example {"gender": 1.0, "age": 0.667}'


def upload_avatar(meaning: str | None, name: str, garments_dir: Path) -> str | None:
    """Returns the avatar for the intake as text; None if the intake shall find the wearer.

    ``meaning`` is a phenotype or SMPL parameters as JSON, ``standard``, or a name of a table. A path is refused, for it
    would name a file of this machine. Without one, the longest entry with which ``name`` begins counts. Tables:
    avatars.json in the folder of uploads, in DRAPE_DATA/garments, and the shipped one.
    """
    folders = [folder for folder in (garments_dir, data_folder("garments"), SHIPPED_FOLDER) if folder is not None]
    if meaning is None:
        found = entry_for(name, folders)
        return None if found is None else _as_text(found[1], found[2])
    text = meaning.strip()
    if text == STANDARD:
        return text
    if text.startswith("{"):
        _check_object(text)
        return text
    tables = [(folder, avatar_table(folder)) for folder in folders]
    for folder, table in tables:
        if text in table:
            return _as_text(table[text], folder)
    known = sorted({key for _, table in tables for key in table})
    raise NotFound(
        "avatar",
        expected=f"a JSON object, {STANDARD!r}" + (f" or one of {', '.join(known)}" if known else ""),
        got=text[:120],
        cure=f"{EXAMPLE}; docs/guide/data.md lists the entries.",
    )


def _check_object(text: str) -> None:
    try:
        fits = isinstance(json.loads(text), dict)
    except (ValueError, RecursionError):  # not only JSONDecodeError: numbers may have too many digits
        fits = False
    if not fits:
        raise BodyError("avatar", expected="a JSON object", got=text[:60], cure=f"{EXAMPLE}.")


def _as_text(entry: dict[str, Any] | str, folder: Path) -> str:
    """A table's entry as an argument; a mesh in it is relative to the table, which is the operator's."""
    if isinstance(entry, dict):
        return json.dumps(entry)
    return entry if entry == STANDARD or entry.startswith("{") else str(folder / entry)
