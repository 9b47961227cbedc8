"""What a body is posed by, as the engine reads it (``drape/engine/source/body.hpp``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.engine.packer import Recorded


@dataclass(frozen=True, eq=False)
class BodyFeed(Recorded):
    """What a body is posed by: ``local`` quaternions (24, 4), joints at ``rest`` [m] (24, 3), shape ``betas``, the
    ``motion`` that is added to the code of the pose, and the skin on its bones: ``skin_rows`` (P, n, 4, 144), none
    where the skin is given, ``skin_bones`` (P, n), and how many of these count (P,)."""

    local: np.ndarray
    rest: np.ndarray
    betas: np.ndarray
    motion: np.ndarray
    skin_rows: np.ndarray
    skin_bones: np.ndarray
    skin_counts: np.ndarray
