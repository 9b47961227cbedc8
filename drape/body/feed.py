"""What a body is posed by, as the engine reads it (``drape/engine/source/body.hpp``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.engine.packer import Recorded


@dataclass(frozen=True, eq=False)
class BodyFeed(Recorded):
    """The numbers that pose a body, as the engine reads them.

    ``local`` (24, 4) are rotations from the parent, quaternions wxyz, ``rest`` [m] (24, 3) the joints at rest, and
    ``betas`` the shape. ``motion`` is added to the code of the pose. The skin is P parts of 48 samples: ``skin_rows``
    (P, n, 4, 144) are the coefficients of points and of two tangents on the n bones ``skin_bones`` (P, n), of which the
    first ``skin_counts`` (P,) count. ``skin_rows`` is empty where the posed skin is given.
    """

    local: np.ndarray
    rest: np.ndarray
    betas: np.ndarray
    motion: np.ndarray
    skin_rows: np.ndarray
    skin_bones: np.ndarray
    skin_counts: np.ndarray
