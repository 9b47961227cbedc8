"""Garments and motions as a command line names them: a shipped name, a file, or a folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from drape.body.model import BodyModel
from drape.errors import ArtifactError, NotFound, did_you_mean
from drape.files.formats import MESH_SUFFIXES
from drape.folders import ASSETS
from drape.garment.cache import GARMENTS_DIR, Garment, load_garment
from drape.motion.readers import MOTION_SUFFIXES

MOTIONS_DIR = ASSETS / "motions"
GARMENT_SUFFIXES = (".npz", *MESH_SUFFIXES)


def find_garments(names: Sequence[str]) -> list[Path]:
    """Cache and mesh files of ``names``; all shipped garments where none is named."""
    return find_files(names, GARMENTS_DIR, GARMENT_SUFFIXES, "garment")


def find_motions(names: Sequence[str]) -> list[Path]:
    """Motion files of ``names``; all shipped clips where none is named."""
    return find_files(names, MOTIONS_DIR, MOTION_SUFFIXES, "motion")


def find_files(names: Sequence[str], folder: Path, suffixes: tuple[str, ...], kind: str) -> list[Path]:
    """Files of ``names``, each a file, a folder, or a name in ``folder``; a folder's avatars are left out.

    Raises ``NotFound``, naming the ``kind`` and what there is, where a name has no file.
    """
    files: list[Path] = []
    for name in names or [str(folder)]:
        path = Path(name)
        if path.is_dir():
            matches = sorted(p for p in path.iterdir() if p.suffix.lower() in suffixes and not _is_avatar(p))
        elif path.is_file():
            matches = [path]
        else:
            matches = [p for p in sorted(folder.iterdir()) if p.suffix in suffixes and short_name(p) == name]
        if not matches:
            known = sorted({short_name(p) for p in folder.iterdir() if p.suffix in suffixes})
            cure = did_you_mean(name, known, "Check the name.")
            raise NotFound(kind, expected=f"one of {known}, a file or a folder", got=name, cure=cure)
        files += matches
    return files


def short_name(path: Path) -> str:
    """The name that finds a file: its stem, or NAME for a cache file NAME-DIGEST16.npz."""
    stem, _, digest = path.stem.rpartition("-")
    return stem if stem and len(digest) == 16 else path.stem


def was_trained_on(garment: Garment, names: Sequence[str]) -> bool:
    """Whether ``garment`` is among those that a model's training ``names``: designs, or files by what they hold.

    Files are named with their folder and suffix or, as a model's manifest does, without.
    """
    design = garment.manifest.get("design", {}).get("name")
    return design in names or Path(garment.file_name()).stem in {Path(name).stem for name in names}


def open_garment(path: Path, body: BodyModel) -> Garment:
    """The garment cached at ``path``, or made from the mesh there; refused if it was made for another body."""
    if path.suffix == ".npz":
        garment = load_garment(path)
    else:
        from drape.garment.intake import intake

        garment = intake(path, body=body)
    check_body(f"garment {garment.name}", garment.body_digest, body)
    return garment


def open_outfit(path: Path, body: BodyModel) -> list[Garment]:
    """The garments in the mesh at ``path``, the innermost first; or the one that is cached there, as ``open_garment``
    gives it."""
    if path.suffix == ".npz":
        return [open_garment(path, body)]
    from drape.garment.intake import intake_outfit

    return intake_outfit(path, body=body)


def check_body(what: str, digest: str, body: BodyModel) -> None:
    """Raises ``ArtifactError`` if ``what`` was made for another body."""
    if digest != body.digest:
        raise ArtifactError(
            f"{what} body",
            expected=f"digest {body.digest[:12]} of {body.name}",
            got=digest[:12],
            cure="Make it again with this body.",
        )


def _is_avatar(path: Path) -> bool:
    return path.stem.startswith("avatar")
