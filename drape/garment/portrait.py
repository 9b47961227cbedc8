"""Pictures of garments at rest, in their own colours and a light from the side that shows folds."""

from __future__ import annotations

import io
from dataclasses import dataclass, field

import numpy as np

from drape.files.looks import NO_LOOKS, Looks, Material
from drape.garment.cache import Garment
from drape.geometry.raster import SKIN, Paint, Surface, render

CLOTH = (0.80, 0.80, 0.82)  # undyed: shade alone tells folds
LIGHT = np.array([0.62, 0.42, 0.66]) / np.linalg.norm([0.62, 0.42, 0.66])  # from the side
AZIMUTH_DEG, MARGIN = 15.0, 1.08
FINER, FINE = 2, 512  # samples along each side of a pixel, in pictures up to that size
COLOURS = 128  # colours of the palette
TEXTURE_PX = 512  # finer textures would not show
SEEN = 0.1  # blended cloth with less alpha is not drawn

Mesh = tuple[np.ndarray, np.ndarray]
"""Vertices [m] (V, 3) and faces (F, 3)."""


@dataclass(frozen=True, eq=False)
class Sitter:
    """A garment to draw: ``vertices`` [m] (V, 3), ``faces`` (F, 3), texture coordinates ``uv`` (T, 2) and ``uv_faces``
    (F, 3) or both empty, ``face_material`` (F,), the number of each face's material, and ``looks``, those of the
    materials."""

    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    uv_faces: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    face_material: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    looks: Looks = NO_LOOKS


def sitter_at_rest(garment: Garment) -> Sitter:
    """Returns the surface of ``garment`` that is drawn, at rest on the body."""
    own, vertices = garment.surface, garment.drawn_at_rest().astype(np.float64)
    return Sitter(vertices, own.faces.astype(np.int64), own.uv, own.uv_faces, own.face_material, own.looks)


def portrait(cloth: Sitter, skin: Mesh | None, size: int, *, whole: bool = False) -> bytes:
    """Returns the bytes of a PNG, ``size`` pixels wide and high, of ``cloth`` on ``skin``, or alone if that is None.
    The cloth fills the picture; with ``whole`` cloth and skin together do."""
    from PIL import Image  # not before the first picture: frames have no use for it

    seen = np.concatenate([cloth.vertices, skin[0]]) if whole and skin is not None else cloth.vertices
    centre = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    extent_m = MARGIN * float(np.ptp(seen, axis=0).max())
    finer = FINER if size <= FINE else 1
    drawn = render(
        [
            *([] if skin is None else [Surface(*skin, SKIN)]),
            Surface(cloth.vertices, cloth.faces, CLOTH, paint=paint_of(cloth)),
        ],
        size=(finer * size, finer * size),
        azimuth_deg=AZIMUTH_DEG,
        centre=centre,
        extent_m=extent_m,
        light=LIGHT,
    )
    drawn = drawn.reshape(size, finer, size, finer, 3).mean(axis=(1, 3))
    image = Image.fromarray(np.round(255.0 * drawn).astype(np.uint8))
    file = io.BytesIO()
    image.quantize(COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(file, "PNG")
    return file.getvalue()


def paint_of(cloth: Sitter) -> Paint | None:
    """Returns a function that gives the colours of ``cloth`` by its looks (``raster.Paint``); None where no material
    has a look. A material without a look has the colour of undyed cloth."""
    known = {number: look for number, look in enumerate(cloth.looks.materials) if look is not None}
    if not known:
        return None
    textures = {number: _texture(cloth.looks, look) for number, look in known.items()} if len(cloth.uv) else {}

    def paint(face: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        colour, there = np.tile(np.array(CLOTH), (len(face), 1)), np.ones(len(face), dtype=bool)
        for number, look in known.items():
            own = np.flatnonzero(cloth.face_material[face] == number)
            rgba = np.tile(np.array(look.base_colour), (len(own), 1))
            if (texture := textures.get(number)) is not None and len(own):
                place = np.einsum("nk,nkc->nc", share[own], cloth.uv[cloth.uv_faces[face[own]]])
                rgba *= _sampled(texture, look, place)
            colour[own] = _srgb(rgba[:, :3])
            least = {"OPAQUE": 0.0, "MASK": look.alpha_cutoff, "BLEND": SEEN}[look.alpha_mode]
            there[own] = rgba[:, 3] >= least
        return colour, there

    return paint


def _texture(looks: Looks, look: Material) -> np.ndarray | None:
    """The picture of the base colour (height, width, 4), linear; None where there is none."""
    from PIL import Image

    if "base_colour" not in look.pictures:
        return None
    with Image.open(io.BytesIO(looks.pictures[look.pictures["base_colour"]])) as image:
        image.draft("RGB", (TEXTURE_PX, TEXTURE_PX))
        plain = image.convert("RGBA")
    plain.thumbnail((TEXTURE_PX, TEXTURE_PX))
    rgba = np.asarray(plain, dtype=np.float32) / 255.0
    rgba[..., :3] = np.where(rgba[..., :3] <= 0.04045, rgba[..., :3] / 12.92, ((rgba[..., :3] + 0.055) / 1.055) ** 2.4)
    return rgba


def _sampled(texture: np.ndarray, look: Material, uv: np.ndarray) -> np.ndarray:
    """``texture`` at ``uv`` (n, 2) with the origin at the lower left, repeated and placed as ``look`` says."""
    (x, y), (sx, sy), (c, s) = look.offset, look.scale, (np.cos(look.rotation), np.sin(look.rotation))
    across, down = sx * uv[:, 0], sy * (1.0 - uv[:, 1])
    place = np.stack([c * across + s * down + x, c * down - s * across + y], axis=1)
    place = np.nan_to_num(place - np.floor(place))  # coordinates far out of any picture give no number
    height, width = texture.shape[:2]
    column, row = np.minimum((place * (width, height)).astype(int), (width - 1, height - 1)).T
    return texture[row, column]


def _srgb(linear: np.ndarray) -> np.ndarray:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1.0 / 2.4) - 0.055)
