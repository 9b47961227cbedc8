"""A character that wears garments, in a line: ``client.avatar("me.vrm").wear("tshirt").play("walk")``.

A motion is a clip, poses of ours (F, 24, 3) [rad], the name of a sample clip, or the local rotations (F, N, 4), x, y,
z, w, of the nodes of its own rig in the order that ``nodes`` tells; ``trans`` [m] (F, 3) is then where the node of its
pelvis is.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from clients.calls import Motion
from clients.stream import DrapeStream

if TYPE_CHECKING:
    from clients.client import DrapeClient


@dataclass(frozen=True)
class Avatar:
    """The character ``id`` of a service, and the garments that it wears, the innermost first, with their options."""

    client: DrapeClient
    id: str
    garments: tuple[str, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)

    def wear(self, *garments: str, **options: Any) -> Avatar:
        """The same character in ``garments``; ``options`` are those of ``drape.wire.options.DrapeOptions``, and
        ``size``."""
        return Avatar(self.client, self.id, garments, options)

    @property
    def nodes(self) -> list[str]:
        """The names of the nodes of its file in the order of rotations of its rig."""
        return self.client.about_avatar(self.id)["nodes"]

    async def stream(self) -> DrapeStream:
        """An open stream of the garments on it, which takes poses of ours (``send``) and of its own rig
        (``send_rig``)."""
        garments = self.garments[0] if len(self.garments) == 1 else self.garments
        return await DrapeStream.open(garment=garments, avatar=self.id, **self.client.reached, **self.options)

    def play(self, motion: str | Motion, *, trans: np.ndarray | None = None) -> list[np.ndarray]:
        """World vertices [m] (F, V, 3) of each garment over a motion."""
        clip = self.client.motion(motion, avatar=self.id) if isinstance(motion, str) else motion
        return self.client.drape_outfit(self.garments, clip, trans=trans, avatar=self.id, **self.options)

    def glb(self, motion: str | Motion, *, trans: np.ndarray | None = None) -> bytes:
        """A GLB of the garments over a motion on its own rig: the nodes of its file, skin weights and morphs, in the
        unit of that file; at once, so that the service says how many frames that may be."""
        clip = self.client.motion(motion, avatar=self.id) if isinstance(motion, str) else motion
        return self.client.drape_glb(self.garments, clip, trans=trans, rig=True, avatar=self.id, **self.options)

    def surface(self, motion: str | Motion, *, trans: np.ndarray | None = None) -> np.ndarray:
        """World vertices [m] (F, V, 3) of its own surface in the same frames."""
        clip = self.client.motion(motion, avatar=self.id) if isinstance(motion, str) else motion
        return self.client.posed_avatar(self.id, clip, trans=trans)
