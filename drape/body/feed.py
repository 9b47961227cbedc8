"""What a body is posed by, as the engine reads it (``drape/engine/source/body.hpp``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.engine.packer import Recorded


@dataclass(frozen=True, eq=False)
class BodyFeed(Recorded):
    """The numbers that pose a body.

    ``local`` quaternions (24, 4), joints at ``rest`` [m] (24, 3), shape ``betas``, the ``motion`` that is added to the
    code of the pose, and the skin on its bones: ``skin_rows`` (P, n, 4, 144), empty where the skin is given,
    ``skin_bones`` (P, n), and ``skin_counts`` (P,): how many of these count.
    """

    local: np.ndarray
    rest: np.ndarray
    betas: np.ndarray
    motion: np.ndarray
    skin_rows: np.ndarray
    skin_bones: np.ndarray
    skin_counts: np.ndarray
