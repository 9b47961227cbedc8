"""The sample clips that ship with the product."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from drape.body.model import BodyModel
from drape.errors import NotFound, did_you_mean
from drape.motion.clip import MotionClip
from drape.motion.grounding import placed_on_ground
from drape.motion.readers import read_motion


class Motions:
    """The clips of one folder, read at the start; an unreadable one stops it."""

    def __init__(self, folder: Path) -> None:
        self._clips = {path.stem: read_motion(path) for path in sorted(folder.glob("*.npz"))}

    def ids(self) -> list[str]:
        return list(self._clips)

    def get(self, name: str) -> MotionClip:
        """The clip ``name``; refuses an unknown one."""
        if name not in self._clips:
            cure = did_you_mean(name, self.ids(), "GET /motions lists the clips.")
            raise NotFound("motion", expected=f"one of: {', '.join(self.ids())}", got=name, cure=cure)
        return self._clips[name]

    def placed(self, name: str, body: BodyModel, betas: np.ndarray) -> MotionClip:
        """Returns the clip ``name`` with translations that put the soles of ``body`` in the shape ``betas`` on the
        ground; ``trans`` is what POST /drape takes."""
        return placed_on_ground(self.get(name), body.rest_joints(betas), floor=body.floor_m(betas))
