"""What a body is posed by, as the engine reads it (``drape/engine/source/body.hpp``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.engine.packer import Recorded


@dataclass(frozen=True, eq=False)
class BodyFeed(Recorded):
    """The numbers that pose a body, as the engine reads them.

    ``local`` (24, 4) are rotations from the parent, quaternions wxyz, ``rest`` [m] (24, 3) the joints at rest, and
    ``betas`` the shape coefficients. ``motion`` (C,) is the network's code of the body's motion, which is added to its
    code (C,) of pose and shape; it is empty where the network is not dynamic.

    ``skin_rows`` (P, n, 4, 144) and ``skin_bones`` (P, n) are the skin, as ``rows`` and ``bones`` of ``SkinOnBones``.
    Of the n bones of a part the first ``skin_counts`` (P,) move it. ``skin_rows`` is empty where the posed skin is
    given.
    """

    local: np.ndarray
    rest: np.ndarray
    betas: np.ndarray
    motion: np.ndarray
    skin_rows: np.ndarray
    skin_bones: np.ndarray
    skin_counts: np.ndarray
