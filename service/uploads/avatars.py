"""Finds the body that an upload was modelled on: the one that the client names, or that of avatars.json for its
name."""

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
    """Returns the body of a garment called ``name`` as text for the intake: JSON, ``standard``, or the path of a mesh
    that a table names. None if the intake shall find the body from the cloth.

    ``meaning`` is a phenotype or SMPL parameters as JSON, ``standard``, or an entry of a table. Where it is None, the
    longest entry that ``name`` begins with counts. Tables are avatars.json in ``garments_dir``, in DRAPE_DATA/garments,
    and the shipped one. Refuses (``NotFound``) anything else, so no client can name a path of this machine.
    """
    folders = [folder for folder in (garments_dir, data_folder("garments"), SHIPPED_FOLDER) if folder is not None]
    if meaning is None:
        entry = entry_for(name, folders)
        return None if entry is None else _as_text(entry[1], entry[2])
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
    except (ValueError, RecursionError):  # ValueError also for numbers with too many digits
        fits = False
    if not fits:
        raise BodyError("avatar", expected="a JSON object", got=text[:60], cure=f"{EXAMPLE}.")


def _as_text(entry: dict[str, Any] | str, folder: Path) -> str:
    """Returns an entry of the table in ``folder`` as text. The path of a mesh is relative to that folder, which belongs
    to the operator."""
    if isinstance(entry, dict):
        return json.dumps(entry)
    return entry if entry == STANDARD or entry.startswith("{") else str(folder / entry)
