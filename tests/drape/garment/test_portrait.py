"""Pictures of garments: cloth in front of skin, in the colours of its materials, each in its place."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from drape.files.looks import Looks, Material
from drape.garment.portrait import CLOTH, Sitter, portrait
from drape.geometry.raster import SKIN
from tests.drape.cloth.cloth_shapes import grid


def test_a_picture_shows_the_cloth_in_the_middle_and_what_stands_behind_it():
    square, faces = grid(40, 40, cell_m=0.05)
    square = square - square.mean(axis=0) + np.array([0.0, 0.0, 0.1])
    behind = (square - np.array([0.0, 0.0, 0.2])) * np.array([1.0, 0.2, 1.0])
    for size in (64, 600):
        image = Image.open(io.BytesIO(portrait(Sitter(0.5 * square, faces), (behind, faces), size)))
        assert image.format == "PNG" and image.size == (size, size)
        pixels = np.asarray(image.convert("RGB"), dtype=float) / 255.0
        middle, corner, beside = pixels[size // 2, size // 2], pixels[1, 1], pixels[size // 2, 1]
        assert (corner == 1.0).all(), "nothing is there"
        np.testing.assert_allclose(middle / middle.max(), np.array(CLOTH) / max(CLOTH), atol=0.03)
        assert beside[0] > 1.15 * beside[2], "skin is redder than cloth"


def pixels_of(payload: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(payload)).convert("RGB"), dtype=float) / 255.0


def quarters() -> bytes:
    """A PNG of four colours: red and green above, blue and a clear white below."""
    rows = [[(255, 0, 0, 255), (0, 255, 0, 255)], [(0, 0, 255, 255), (255, 255, 255, 0)]]
    out = io.BytesIO()
    Image.fromarray(np.repeat(np.repeat(np.array(rows, dtype=np.uint8), 8, axis=0), 8, axis=1)).save(out, "PNG")
    return out.getvalue()


def sitter(look: Material | None, pictures: tuple[bytes, ...] = ()) -> Sitter:
    """A square in front of the viewer whose texture coordinates are its own, from the lower left."""
    square, faces = grid(20, 20, cell_m=0.05)
    square = square - square.mean(axis=0)
    uv = (square[:, :2] - square[:, :2].min(axis=0)) / np.ptp(square[:, :2], axis=0)
    number = np.zeros(len(faces), dtype=np.int64)
    return Sitter(square, faces, uv, faces, number, Looks((look,), pictures))


def corners(payload: bytes) -> list[str]:
    """Which channel stands out in the four quarters, row by row; "" where none does."""
    pixels = pixels_of(payload)
    size = len(pixels)
    found = [pixels[int(size * y), int(size * x)] for y in (0.3, 0.7) for x in (0.35, 0.65)]
    return ["".join("rgb"[c] for c in range(3) if one[c] > 2.0 * np.delete(one, c).max()) for one in found]


def test_a_picture_lies_upright_and_what_is_cut_out_is_not_drawn():
    opaque = Material(pictures={"base_colour": 0})
    cut = Material(pictures={"base_colour": 0}, alpha_mode="MASK")
    assert corners(portrait(sitter(opaque, (quarters(),)), None, 128)) == ["r", "g", "b", ""]
    shown, missing = (pixels_of(portrait(sitter(one, (quarters(),)), None, 128))[89, 83] for one in (opaque, cut))
    assert (missing == 1.0).all() and (shown < 0.99).all(), "the wall behind, and white cloth in a shade"


def test_a_picture_is_placed_as_its_material_says():
    turned = Material(pictures={"base_colour": 0}, offset=(0.5, 0.0))
    assert corners(portrait(sitter(turned, (quarters(),)), None, 128)) == ["g", "r", "", "b"]
    around = Material(pictures={"base_colour": 0}, rotation=float(np.pi), offset=(1.0, 1.0))
    assert corners(portrait(sitter(around, (quarters(),)), None, 128)) == ["", "b", "g", "r"]


def test_a_material_without_a_picture_has_its_colour_and_one_without_a_look_is_undyed():
    red = pixels_of(portrait(sitter(Material(base_colour=(0.8, 0.02, 0.02, 1.0))), None, 96))[48, 48]
    plain = pixels_of(portrait(sitter(None), None, 96))[48, 48]
    assert red[0] > 3.0 * red[1:].max()
    np.testing.assert_allclose(plain / plain.max(), np.array(CLOTH) / max(CLOTH), atol=0.03)


def test_all_of_the_body_is_in_a_picture_of_both():
    body, faces = grid(40, 40, cell_m=0.05)
    body = body - body.mean(axis=0) - np.array([0.0, 0.0, 0.2])
    one = sitter(None)
    both, close = (pixels_of(portrait(one, (body, faces), 96, whole=whole)) for whole in (True, False))
    skin = np.array(SKIN) / max(SKIN)
    assert np.abs(both[20, 48] / both[20, 48].max() - skin).max() < 0.03, "skin above the cloth"
    assert (both[2, 2] == 1.0).all(), "and a margin"
    assert (close[2] < 1.0).any(), "close by it fills the picture"
