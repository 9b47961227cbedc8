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
from drape.export.pc2 import pc2_head, pc2_samples
from drape.export.root_motion import RootMotion
from drape.export.surface import Surface, by_layer
from drape.export.usda import MovingGarment, usda_pieces
from drape.files.atomic import whole_file

SUFFIXES = (".glb", ".npy", ".pc2", ".mdd", ".usda")
CACHES = (".pc2", ".mdd")  # points without a mesh, which comes beside


def check_name(path: Path, suffixes: Sequence[str] = SUFFIXES) -> None:
    """Refuses (``InputError``) a file of no kind that is written, or in a folder that is not there."""
    if path.suffix.lower() not in suffixes:
        expected = f"a name ending in {', '.join(suffixes)}"
        raise InputError("--out", expected=expected, got=path.name, cure="Rename it.")
    if not path.absolute().parent.is_dir():
        raise InputError("--out", expected="an existing folder", got=str(path.parent), cure="Make the folder first.")


def clip_pieces(
    suffix: str,
    surfaces: Sequence[Surface],
    vertices: np.ndarray,
    fps: float,
    root_motion: RootMotion | None = None,
) -> Iterator[bytes]:
    """The file of the ``surfaces`` at ``vertices`` [m] (F, V, 3), one after the other, in pieces.

    ``root_motion`` quantises a GLB (``drape.export.glb``).
    """
    layers = by_layer(surfaces, vertices)
    colours = itertools.cycle(GARMENT_COLOURS)
    if suffix == ".glb":
        file = GlbFile()
        for surface, layer, colour in zip(surfaces, layers, colours, strict=False):
            add_garment(file, surface, layer, fps, colour, root_motion=root_motion)
        return itertools.chain([file.head()], file.pieces())
    if suffix == ".usda":
        moving = [MovingGarment(*parts[:2], parts[2][:3]) for parts in zip(surfaces, layers, colours, strict=False)]
        return usda_pieces(moving, fps)
    count, frames = vertices.shape[1], len(vertices)
    if suffix == ".mdd":
        return itertools.chain([mdd_head(count, frames, fps=fps)], [mdd_frames(vertices)])
    head = pc2_head(count, frames) if suffix == ".pc2" else npy_head(count, frames)
    return itertools.chain([head], [pc2_samples(vertices)])


def npy_head(points: int, frames: int) -> bytes:
    """The head of a .npy file of float32 (frames, points, 3)."""
    buffer = io.BytesIO()
    shape = {"descr": "<f4", "fortran_order": False, "shape": (frames, points, 3)}
    np.lib.format.write_array_header_1_0(buffer, shape)
    return buffer.getvalue()


def write_pieces(path: Path, pieces: Iterable[bytes]) -> None:
    """Writes ``path`` whole or not at all; what ``pieces`` raise leaves no file. Refuses (``InputError``) a place that
    cannot be written."""
    wanted = "a folder that can be written"
    try:
        with whole_file(path) as stream:
            wanted = "room to write"
            stream.writelines(pieces)
    except OSError as error:
        raise InputError(str(path), expected=wanted, got=str(error.strerror), cure="Choose another --out.") from error
