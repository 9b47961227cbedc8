"""The stages of a frame, in order.

A new stage is a file here, a line in ``STAGES``, and a field of ``drape.wire.options`` where clients choose.
"""

from __future__ import annotations

from drape.stages.colliders import Colliders
from drape.stages.collision import Collision
from drape.stages.encode import Encode
from drape.stages.folds import Folds
from drape.stages.hang import Hang
from drape.stages.mantles import Mantles
from drape.stages.motion import Motion
from drape.stages.network import Network, Novelty
from drape.stages.stage import Stage, StageSetup
from drape.stages.swing import Swing

STAGES: tuple[type[Stage], ...] = (
    Novelty, Motion, Network, Mantles, Swing, Folds, Colliders, Collision, Hang, Encode,
)  # fmt: skip


def make_stages(setup: StageSetup) -> tuple[Stage, ...]:
    """Returns a stage of each class of ``STAGES``, in their order."""
    return tuple(stage(setup) for stage in STAGES)
