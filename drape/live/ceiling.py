"""The ceiling of an inner garment: it gives way to the garment that is worn over it.

Layers are draped one by one, and the network knows no other layer. A dress stands out through the shirt that is worn
over it, and loose trousers crumple the T-shirt that rests on them. In life the outer garment presses the inner one to
the skin. So the outer garment is a ceiling, and what is above it comes down, with the cloth around
(``source/layers.hpp`` of the engine).

Folds are of the drape as the network has it, and what is pressed are the folded vertices, while the memory of folds
keeps them as they were: cloth that is pressed before it folds is too long for its place and crumples below the hem. The
outer garment's drape without folds presses before that garment folds on what is left, and its folds press once more.
"""

from __future__ import annotations

import numpy as np

from drape.engine.calls import call_with_scratch
from drape.live.fold_constants import LaidCloth


def ceiling_over(vertices: np.ndarray, outer: LaidCloth, skin: np.ndarray) -> np.ndarray:
    """Returns the ceiling (S, 5) that the garment ``outer`` with ``vertices`` [m] (V, 3) is over the samples ``skin``
    (S, 8), rows of ``sample_table`` in the same frame. An inner garment is pressed below it.

    A row has the ceiling's height [m] over the sample, infinite where nothing covers it, the unit normal n of a plane
    and its offset d [m]: a point x is n . x - d above the ceiling.
    """
    dtype, ceiling = outer.dtype, np.empty((len(skin), 5), outer.dtype)
    x, samples = np.ascontiguousarray(vertices, dtype), np.ascontiguousarray(skin, dtype)
    call_with_scratch("ceiling", dtype, x, outer, samples, len(samples), ceiling)
    return ceiling


def lower(ceiling: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Returns for each sample the lower of two ceilings (..., S, 5), rows as of ``ceiling_over``."""
    return np.where(other[..., :1] < ceiling[..., :1], other, ceiling)


def press(
    vertices: np.ndarray, inner: LaidCloth, own: np.ndarray, ground: np.ndarray, ceiling: np.ndarray
) -> np.ndarray:
    """Returns the ``vertices`` [m] (V, 3) of the garment ``inner``, moved below the ``ceiling`` (S, 5) together with
    the cloth around them; ``vertices`` itself where none is too high.

    ``ceiling`` has rows as of ``ceiling_over``. ``ground`` (S, 8) are the samples that the garment rests on, rows of
    ``sample_table``; ``own`` (P,) is the index of the sample under each place of its ``Sheet``.
    """
    dtype = inner.dtype
    x, samples = np.ascontiguousarray(vertices, dtype), np.ascontiguousarray(ground, dtype)
    out, planes = np.empty_like(x), np.ascontiguousarray(ceiling, dtype)
    found = call_with_scratch("press", dtype, x, inner, own, samples, len(samples), planes, out)
    return out.astype(vertices.dtype, copy=False) if found else vertices
