"""The network's drape of one garment on one body: posed jets of its patches.

It computes what ``training.onefit.OneFit`` does, by the constants that ``drape.graph.packing`` lays out; the formulas
are in ``drape/engine/source/network.hpp``.
"""

from __future__ import annotations

import numpy as np

from drape.engine.calls import call_with_scratch
from drape.geometry import jets
from drape.graph.blend import PosedJets
from drape.network.bodies import PosedBody
from drape.network.patch_rows import PatchRows
from drape.network.weights import Weights


def checked_jets(
    weights: Weights, rows: PatchRows, body: PosedBody, passes: int, patches: int
) -> tuple[PosedJets, bool]:
    """Returns the K ``patches`` posed on ``body``, with full jets (K, 45) after ``passes`` corrections, and whether all
    their numbers are finite."""
    kind = body.skin.dtype
    found = PosedJets(*(np.empty((patches, *shape), kind) for shape in ((jets.FULL_COUNT,), (3, 3), (3,))))
    finite = call_with_scratch("jets", kind, weights, rows, body, passes, found)
    return found, bool(finite)
