"""Contact sheets of rastered pictures, and palette PNGs of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from drape.geometry.raster import BACKGROUND, CLOTH, LIGHT, SKIN, Surface, render, view_matrix

__all__ = [
    "BACKGROUND",
    "CLOTH",
    "LIGHT",
    "PLAIN_CLOTH",
    "RAKING_LIGHT",
    "SKIN",
    "Surface",
    "render",
    "save_png",
    "sheet",
    "view_matrix",
]
PLAIN_CLOTH = (0.80, 0.80, 0.82)  # undyed: shade alone tells its folds
RAKING_LIGHT = np.array([0.86, 0.42, 0.28]) / np.linalg.norm([0.86, 0.42, 0.28])  # low from the side


def sheet(rows: list[list[np.ndarray]]) -> np.ndarray:
    """One picture from rows of equally sized pictures."""
    return np.concatenate([np.concatenate(row, axis=1) for row in rows], axis=0)


def save_png(path: Path, image: np.ndarray, *, colours: int = 64) -> None:
    """Writes ``image`` as a palette PNG: contact sheets stay well under 400 KB."""
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    picture = Image.fromarray((np.clip(image, 0, 1) * 255).astype(np.uint8))
    picture.quantize(colours, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(path, optimize=True)
