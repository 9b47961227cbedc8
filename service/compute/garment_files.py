"""Files of uploaded garments: a cache each, its ``About`` beside it, and which cache has which id.

Several services may share the folder. So files appear whole (``os.replace``), and an id belongs to the cache that
claimed it first.
"""

from __future__ import annotations

import contextlib
import json
import os
import uuid
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from drape.errors import ArtifactError, InputError
from drape.stages.scene import UNCHANGED, About
from service.compute.json_records import parsed_record

OWNED = "of-"  # the name of a key's folder begins with it
IDS = ".ids"  # the folder with a file for each id of a garment without owner, which holds the name of its cache


def folder_of(root: Path, owner: str | None) -> Path:
    """Returns the folder under ``root`` for garments of the key ``owner``; ``root`` itself for None."""
    return root if owner is None else root / f"{OWNED}{owner}"


def owner_of(path: Path | None) -> str | None:
    """Returns the key in whose folder the file ``path`` lies; None where it lies in no key's folder."""
    folder = "" if path is None else path.parent.name
    return folder.removeprefix(OWNED) if folder.startswith(OWNED) else None


def list_shipped(folder: Path, variable: str) -> list[Path]:
    """Returns the npz files in ``folder``, sorted. Refuses (``InputError``) a folder that does not exist; ``variable``
    is the setting that names it."""
    if not folder.is_dir():
        cure = "Correct or unset the variable."
        raise InputError(variable, expected="an existing folder", got=str(folder), cure=cure)
    return sorted(folder.glob("*.npz"))


def list_caches(root: Path) -> dict[Path, tuple[int, int]]:
    """Returns for every cache under ``root``, by its path, two times [ns since 1970]: when it was written, and when its
    ``About`` was, 0 where it has none. The oldest cache comes first, which keeps ids of equal names the same at every
    start."""
    rows: list[tuple[int, str, Path, int]] = []
    for path in (*root.glob("*.npz"), *root.glob(f"{OWNED}*/*.npz")):
        written_ns = _written_ns(path)
        if written_ns:  # 0: another service has just removed it
            rows.append((written_ns, path.name, path, _written_ns(about_path(path))))
    return {path: (written_ns, about_ns) for written_ns, _, path, about_ns in sorted(rows)}


def list_avatar_facts(root: Path) -> dict[Path, int]:
    """Returns every file under ``root`` that holds the facts of an avatar, with the time [ns since 1970] at which it
    was written, the oldest first."""
    rows = ((_written_ns(path), path) for path in (*root.glob("*.json"), *root.glob(f"{OWNED}*/*.json")))
    return {path: written_ns for written_ns, path in sorted(rows) if written_ns}


def _written_ns(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except FileNotFoundError:
        return 0


def file_sizes(folders: Iterable[Path]) -> list[int]:
    """Returns the sizes in bytes of the caches and avatars' files that lie directly in ``folders``."""
    sizes: list[int] = []
    for path in (path for folder in folders for kind in ("*.npz", "*.glb") for path in folder.glob(kind)):
        try:
            sizes.append(path.stat().st_size)
        except FileNotFoundError:  # removed meanwhile
            continue
    return sizes


def about_path(path: Path) -> Path:
    """Returns the path of the file for the ``About`` of the cache ``path``."""
    return path.with_suffix(".about.json")


def read_about(path: Path) -> About:
    """Returns the ``About`` of the cache ``path``: its title and whether it is published; ``UNCHANGED`` if there is no
    such file. Refuses (``ArtifactError``) a file that holds something else."""
    try:
        return parsed_record(About, about_path(path))
    except FileNotFoundError:
        return UNCHANGED
    except ValueError as error:
        cure = f"Delete {about_path(path).name}."
        label = f"garment {path.stem}"
        raise ArtifactError(label, expected="title and published", got="something else", cure=cure) from error


def write_about(path: Path, about: About) -> None:
    """Writes ``about`` to a file beside the cache ``path``, whole or not at all."""
    replace_text(about_path(path), json.dumps(asdict(about)))


def remove_cache(path: Path, claimed: str) -> None:
    """Deletes the cache ``path``, its ``About`` and its claim on the id ``claimed``, as far as they exist."""
    path.unlink(missing_ok=True)
    about_path(path).unlink(missing_ok=True)
    mine = path.parent / IDS / claimed
    with contextlib.suppress(FileNotFoundError):
        if mine.read_text(encoding="utf-8") == path.name:
            mine.unlink()


def replace_text(path: Path, text: str) -> None:
    """Writes ``text`` to ``path`` so that other processes read the old text or the whole new one."""
    fresh = path.with_name(f"{path.name}.{uuid.uuid4().hex[:8]}.new")
    fresh.write_text(text, encoding="utf-8")
    os.replace(fresh, path)


def claim(path: Path, wanted: str) -> bool:
    """Claims the id ``wanted`` for the cache ``path``. Returns whether the cache has the id from now on: if no cache
    had it, this one had it already, or the one that had it is gone."""
    folder = path.parent / IDS
    folder.mkdir(exist_ok=True)
    mine, fresh = folder / wanted, folder / f"{uuid.uuid4().hex}.new"
    fresh.write_text(path.name, encoding="utf-8")
    try:
        os.link(fresh, mine)  # the file appears with its text, or not at all
        return True
    except FileExistsError:
        holder = mine.read_text(encoding="utf-8", errors="replace")[:200].replace("\0", "")
        if holder == path.name or (path.parent / holder).exists():
            return holder == path.name
        os.replace(fresh, mine)
        return True
    finally:
        fresh.unlink(missing_ok=True)
