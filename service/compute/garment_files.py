"""Uploaded garments on disk: a cache each, beside it what was changed of it, and whose id is whose.

Several services may have the same folder: files come whole (``os.replace``), and an id belongs to the garment that
claimed it first, wherever it was uploaded.
"""

from __future__ import annotations

import contextlib
import json
import os
import uuid
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from drape.errors import ArtifactError
from drape.stages.scene import UNCHANGED, About
from service.compute.json_records import parsed_record

OWNED = "of-"  # begins the folder of a key's garments
IDS = ".ids"  # a file for each id of a garment without owner: the name of the cache that has it


def folder_of(root: Path, owner: str | None) -> Path:
    """The folder of garments of the key ``owner`` under ``root``."""
    return root if owner is None else root / f"{OWNED}{owner}"


def owner_of(path: Path | None) -> str | None:
    """The key whose folder ``path`` lies in, if it is one."""
    folder = "" if path is None else path.parent.name
    return folder.removeprefix(OWNED) if folder.startswith(OWNED) else None


def list_caches(root: Path) -> dict[Path, tuple[int, int]]:
    """Every cache under ``root`` with the times [ns] at which it and its ``About`` were written (0: it has none).

    In the order of arrival, so that ids given to equal names stay the same.
    """
    rows: list[tuple[int, str, Path, int]] = []
    for path in (*root.glob("*.npz"), *root.glob(f"{OWNED}*/*.npz")):
        written_ns = _written_ns(path)
        if written_ns:  # 0: another service has just removed it
            rows.append((written_ns, path.name, path, _written_ns(about_path(path))))
    return {path: (written_ns, about_ns) for written_ns, _, path, about_ns in sorted(rows)}


def list_avatar_facts(root: Path) -> dict[Path, int]:
    """Returns every file under ``root`` that holds the facts of an avatar, with the time [ns] at which it was written;
    the oldest first."""
    written = ((path, _written_ns(path)) for path in (*root.glob("*.json"), *root.glob(f"{OWNED}*/*.json")))
    return dict(sorted((one for one in written if one[1]), key=lambda one: one[1]))


def _written_ns(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except FileNotFoundError:
        return 0


def file_sizes(folders: Iterable[Path]) -> list[int]:
    """Bytes of every cache, and of every file of an avatar, directly in ``folders``."""
    bytes_each: list[int] = []
    for path in (path for folder in folders for kind in ("*.npz", "*.glb") for path in folder.glob(kind)):
        try:
            bytes_each.append(path.stat().st_size)
        except FileNotFoundError:  # removed meanwhile
            continue
    return bytes_each


def about_path(path: Path) -> Path:
    """The file that holds the ``About`` of the cache ``path``."""
    return path.with_suffix(".about.json")


def read_about(path: Path) -> About:
    """Returns the ``About`` of the cache ``path``: what its owner changed. Refuses (``ArtifactError``) a file that
    holds none."""
    try:
        return parsed_record(About, about_path(path))
    except FileNotFoundError:
        return UNCHANGED
    except ValueError as error:
        cure = f"Delete {about_path(path).name}."
        label = f"garment {path.stem}"
        raise ArtifactError(label, expected="title and published", got="something else", cure=cure) from error


def write_about(path: Path, about: About) -> None:
    """Stores ``about`` beside the cache ``path``, whole or not at all."""
    replace_text(about_path(path), json.dumps(asdict(about)))


def remove_cache(path: Path, claimed: str) -> None:
    """Takes the cache ``path``, its ``About`` and its claim on the id ``claimed`` off the disk, if they are there."""
    path.unlink(missing_ok=True)
    about_path(path).unlink(missing_ok=True)
    mine = path.parent / IDS / claimed
    with contextlib.suppress(FileNotFoundError):
        if mine.read_text(encoding="utf-8") == path.name:
            mine.unlink()


def replace_text(path: Path, text: str) -> None:
    """Writes ``text`` to ``path``, of which a reader sees all or nothing."""
    fresh = path.with_name(f"{path.name}.{uuid.uuid4().hex[:8]}.new")
    fresh.write_text(text, encoding="utf-8")
    os.replace(fresh, path)


def claim(path: Path, wanted: str) -> bool:
    """Claims the id ``wanted`` for the cache ``path``, and returns whether it is that cache's from now on.

    It is if nobody has it, if the cache itself has it, or if the cache that has it is gone.
    """
    folder = path.parent / IDS
    folder.mkdir(exist_ok=True)
    mine, fresh = folder / wanted, folder / f"{uuid.uuid4().hex}.new"
    fresh.write_text(path.name, encoding="utf-8")
    try:
        os.link(fresh, mine)  # with what it says, or not at all
        return True
    except FileExistsError:
        holder = mine.read_text(encoding="utf-8", errors="replace")[:200].replace("\0", "")
        if holder == path.name or (path.parent / holder).exists():
            return holder == path.name
        os.replace(fresh, mine)
        return True
    finally:
        fresh.unlink(missing_ok=True)
