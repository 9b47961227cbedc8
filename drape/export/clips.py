"""A draped clip as a file of the kind that its name says."""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from drape.errors import InputError
from drape.export.glb import GARMENT_COLOURS, add_garment
from drape.export.glb_file import GlbFile
from drape.export.mdd import mdd_frames, mdd_head
from drape.export.obj import obj_text
from drape.export.pc2 import pc2_head, pc2_samples
from drape.export.root_motion import RootMotion
from drape.export.surface import MovingGarment, Surface, by_layer
from drape.export.usd_stage import SUFFIXES as USD_SUFFIXES
from drape.export.usd_stage import check_usd, usd_file
from drape.export.usda import usda_pieces
from drape.export.vat import ENDING, check_vat, vat_files
from drape.export.vat import SUFFIX as VAT_SUFFIX
from drape.files.atomic import whole_file

SCENES = (".usda", *USD_SUFFIXES, VAT_SUFFIX)
SUFFIXES = (".glb", ".npy", ".pc2", ".mdd", *SCENES)
CACHES = (".pc2", ".mdd")  # Such files have points and no mesh, which is written beside them.


def check_name(path: Path, suffixes: Sequence[str] = SUFFIXES) -> None:
    """Checks the name of a file that is to be written. Raises ``InputError`` for a suffix that is not in ``suffixes``
    and for a folder that does not exist, ``Unavailable`` where the package that writes such a file is not installed."""
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        expected = f"a name ending in {', '.join(suffixes)}"
        raise InputError("--out", expected=expected, got=path.name, cure="Rename it.")
    if not path.absolute().parent.is_dir():
        raise InputError("--out", expected="an existing folder", got=str(path.parent), cure="Make the folder first.")
    if suffix in USD_SUFFIXES:
        check_usd()
    if suffix == VAT_SUFFIX:
        check_vat()
        if not path.stem.endswith(ENDING):
            cure = f"Call it {path.stem}{ENDING}{suffix}."
            raise InputError("--out", expected=f"a name ending in {ENDING}{suffix}", got=path.name, cure=cure)


def moving_layers(surfaces: Sequence[Surface], vertices: np.ndarray) -> list[MovingGarment]:
    """Returns the ``surfaces`` as garments that move, in ``GARMENT_COLOURS`` in turn. ``vertices`` [m] (F, V, 3) are
    those of all surfaces, one after the other."""
    colours = itertools.cycle(GARMENT_COLOURS)
    return list(map(MovingGarment, surfaces, by_layer(surfaces, vertices), colours))


def write_scene(path: Path, layers: Sequence[MovingGarment], fps: float) -> list[Path]:
    """Writes ``layers`` at ``fps`` frames a second to ``path``, whose suffix is one of ``SCENES``; the file is whole or
    not there. Returns the paths of the other files that it has written beside it."""
    suffix = path.suffix.lower()
    if suffix == VAT_SUFFIX:
        made = vat_files(layers, fps, path.stem.removesuffix(ENDING))
        for name, content in made.items():
            write_pieces(path.with_name(name), [content])
        return [path.with_name(name) for name in made if name != path.name]
    write_pieces(path, [usd_file(layers, fps, suffix)] if suffix in USD_SUFFIXES else usda_pieces(layers, fps))
    return []


def write_clip(
    path: Path, surfaces: Sequence[Surface], vertices: np.ndarray, fps: float, root_motion: RootMotion | None = None
) -> list[Path]:
    """Writes the ``surfaces`` at ``vertices`` [m] (F, V, 3), one surface after the other, to ``path``, whose suffix is
    one of ``SUFFIXES``. Returns the paths of what it has written beside it: the mesh of a point cache, the other files
    of a texture.

    With ``root_motion`` a GLB is quantised (``drape.export.glb``).
    """
    suffix = path.suffix.lower()
    if suffix in SCENES:
        return write_scene(path, moving_layers(surfaces, vertices), fps)
    write_pieces(path, _clip_pieces(suffix, surfaces, vertices, fps, root_motion))
    if suffix not in CACHES:
        return []
    beside = path.with_suffix(".obj")
    first = [layer[0] for layer in by_layer(surfaces, vertices)]
    write_pieces(beside, [obj_text(surfaces, first).encode()])
    return [beside]


def _clip_pieces(
    suffix: str, surfaces: Sequence[Surface], vertices: np.ndarray, fps: float, root_motion: RootMotion | None
) -> Iterator[bytes]:
    """What ``write_clip`` writes into a file of GLB, NPY, PC2 or MDD, in pieces."""
    if suffix == ".glb":
        file = GlbFile()
        for one in moving_layers(surfaces, vertices):
            add_garment(file, one.surface, one.vertices, fps, one.colour, root_motion=root_motion)
        return itertools.chain([file.head()], file.pieces())
    count, frames = vertices.shape[1], len(vertices)
    if suffix == ".mdd":
        return itertools.chain([mdd_head(count, frames, fps=fps)], [mdd_frames(vertices)])
    head = pc2_head(count, frames) if suffix == ".pc2" else npy_head(count, frames)
    return itertools.chain([head], [pc2_samples(vertices)])


def npy_head(points: int, frames: int) -> bytes:
    """Returns the bytes that a .npy file of float32 numbers (``frames``, ``points``, 3) begins with."""
    buffer = io.BytesIO()
    shape = {"descr": "<f4", "fortran_order": False, "shape": (frames, points, 3)}
    np.lib.format.write_array_header_1_0(buffer, shape)
    return buffer.getvalue()


def write_pieces(path: Path, pieces: Iterable[bytes]) -> None:
    """Writes ``pieces`` one after the other to ``path``, whole or not at all: an error leaves what was there. Raises
    ``InputError`` where it cannot be written."""
    wanted = "a folder that can be written"
    try:
        with whole_file(path) as stream:
            wanted = "room to write"
            stream.writelines(pieces)
    except OSError as error:
        raise InputError(str(path), expected=wanted, got=str(error.strerror), cure="Choose another --out.") from error
