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
    """Returns the garment files, cache (.npz) or mesh, that ``names`` name: shipped names, files or folders. Without
    names they are all shipped garments. Raises ``NotFound`` for a name without a file."""
    return find_files(names, GARMENTS_DIR, GARMENT_SUFFIXES, "garment")


def find_motions(names: Sequence[str]) -> list[Path]:
    """Returns the motion files that ``names`` name: shipped names, files or folders. Without names they are all shipped
    clips. Raises ``NotFound`` for a name without a file."""
    return find_files(names, MOTIONS_DIR, MOTION_SUFFIXES, "motion")


def find_files(names: Sequence[str], folder: Path, suffixes: tuple[str, ...], kind: str) -> list[Path]:
    """Returns the files that ``names`` name, in their order; without names all those of ``folder``. A name is a file, a
    folder, which stands for its files with one of the ``suffixes``, or the ``short_name`` of files in ``folder``. Files
    of a folder that begin with "avatar" are left out. Raises ``NotFound`` where a name has no file; the message says
    which ``kind`` of file and which names there are."""
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
    """Returns the stem of ``path`` by which a command line names it; of a cache file NAME-DIGEST16.npz only NAME."""
    stem, _, digest = path.stem.rpartition("-")
    return stem if stem and len(digest) == 16 else path.stem


def was_trained_on(garment: Garment, names: Sequence[str]) -> bool:
    """Returns whether ``garment`` is one of the ``names`` of the garments that a model was trained on. A name is that
    of the garment's design, or that of its cache file; the folder and the suffix of a file do not count."""
    design = garment.manifest.get("design", {}).get("name")
    return design in names or Path(garment.file_name()).stem in {Path(name).stem for name in names}


def open_garment(path: Path, body: BodyModel) -> Garment:
    """Returns the garment in the cache file (.npz) at ``path``, or the one that ``intake`` makes of the mesh file
    there. Raises ``ArtifactError`` for a garment of another body than ``body`` and for a damaged cache file, and
    ``InputError`` for a mesh that intake refuses."""
    if path.suffix == ".npz":
        garment = load_garment(path)
    else:
        from drape.garment.intake import intake

        garment = intake(path, body=body)
    check_body(f"garment {garment.name}", garment.body_digest, body)
    return garment


def open_outfit(path: Path, body: BodyModel) -> list[Garment]:
    """Returns the garments that ``intake_outfit`` makes of the mesh file at ``path``, the innermost first. Of a cache
    file (.npz) it is the one garment in it. Raises as ``open_garment`` does."""
    if path.suffix == ".npz":
        return [open_garment(path, body)]
    from drape.garment.intake import intake_outfit

    return intake_outfit(path, body=body)


def check_body(what: str, digest: str, body: BodyModel) -> None:
    """Raises ``ArtifactError``, which names ``what``, if the body digest ``digest`` is not that of ``body``."""
    if digest != body.digest:
        raise ArtifactError(
            f"{what} body",
            expected=f"digest {body.digest[:12]} of {body.name}",
            got=digest[:12],
            cure="Make it again with this body.",
        )


def _is_avatar(path: Path) -> bool:
    return path.stem.startswith("avatar")
