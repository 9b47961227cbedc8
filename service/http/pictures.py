"""Pictures of garments at rest on their body, in a light from the side that shows folds."""

from __future__ import annotations

import io

import numpy as np

from drape.geometry.raster import SKIN, Surface, render

PNG = "image/png"
CLOTH = (0.80, 0.80, 0.82)  # undyed: shade alone tells folds
LIGHT = np.array([0.62, 0.42, 0.66]) / np.linalg.norm([0.62, 0.42, 0.66])  # from the side
AZIMUTH_DEG, MARGIN = 15.0, 1.08
FINER, FINE = 2, 512  # samples of a pixel along each side, of pictures up to that size
COLOURS = 128  # of the palette
KEPT = 64  # pictures, of up to a quarter of a megabyte


def picture(cloth: tuple[np.ndarray, np.ndarray], skin: tuple[np.ndarray, np.ndarray] | None, size: int) -> bytes:
    """A PNG of ``size`` pixels along each side of vertices [m] (V, 3) and faces (F, 3) of ``cloth`` on ``skin``, or
    alone; the cloth fills it."""
    from PIL import Image  # not before the first picture: frames have no use for it

    vertices = cloth[0]
    centre, extent_m = (
        0.5 * (vertices.min(axis=0) + vertices.max(axis=0)),
        MARGIN * float(np.ptp(vertices, axis=0).max()),
    )
    finer = FINER if size <= FINE else 1
    drawn = render(
        [*([] if skin is None else [Surface(*skin, SKIN)]), Surface(*cloth, CLOTH)],
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
