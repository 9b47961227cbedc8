"""The skin that an outer garment feels, raised by the cloth that lies on it.

A sample of the skin goes up along its normal to the highest vertex of the inner garments that lies over it
(``source/layers.hpp`` of the engine). The planes of raised samples are blended as those of the skin are. So an outer
garment rests on the inner one as that does on the body, with the same gap. Nothing changes where nothing is worn below.
"""

from __future__ import annotations

import numpy as np

from drape.engine.calls import call, call_with_scratch
from drape.live.fold_constants import LaidCloth


def raise_skin(skin: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Returns the samples ``skin`` (..., S, 8), rows of ``sample_table``, each moved by its ``height`` [m] (..., S)
    along its normal."""
    out, ground = np.empty_like(skin), np.ascontiguousarray(skin)
    call("raise", skin.dtype, ground, ground.size // 8, np.ascontiguousarray(height, skin.dtype), out)
    return out


def heights_over(vertices: np.ndarray, inner: LaidCloth, own: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """Returns how high [m] (S,) the garment ``inner`` raises each of the samples ``skin`` (S, 8): 0 where no vertex
    lies over it.

    The garment's ``vertices`` are [m] (V, 3), and its triangles face outward. ``own`` (P,) is the index of the sample
    under each place of its ``Sheet``. A vertex raises this sample and the neighbours of this sample.
    """
    dtype, height = inner.dtype, np.empty(len(skin), inner.dtype)
    x, samples = np.ascontiguousarray(vertices, dtype), np.ascontiguousarray(skin, dtype)
    call_with_scratch("heights", dtype, x, inner, own, samples, len(samples), height)
    return height
