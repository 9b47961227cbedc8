"""The stages of a frame, in order.

A new stage is a file here, a line in ``STAGES``, and a field of ``drape.wire.options`` where clients choose.
"""

from __future__ import annotations

from service.stages.colliders import Colliders
from service.stages.collision import Collision
from service.stages.encode import Encode
from service.stages.folds import Folds
from service.stages.motion import Motion
from service.stages.network import Network, Novelty
from service.stages.stage import Stage, StageSetup
from service.stages.swing import Swing

STAGES: tuple[type[Stage], ...] = (Novelty, Motion, Network, Swing, Folds, Colliders, Collision, Encode)


def make_stages(setup: StageSetup) -> tuple[Stage, ...]:
    """All stages of a service, in order."""
    return tuple(stage(setup) for stage in STAGES)
