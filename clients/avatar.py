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
    """An avatar of a service, the garments that it wears, the innermost first, and their options."""

    client: DrapeClient
    id: str
    garments: tuple[str, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)

    def wear(self, *garments: str, **options: Any) -> Avatar:
        """Returns the same avatar in ``garments``. ``options`` are the fields of ``drape.wire.options.DrapeOptions``,
        and ``size``.
        """
        return Avatar(self.client, self.id, garments, options)

    @property
    def nodes(self) -> list[str]:
        """The names of the nodes of its file, in the order of the rotations of its rig."""
        return self.client.about_avatar(self.id)["nodes"]

    async def stream(self) -> DrapeStream:
        """Opens a stream of the garments on the avatar. It takes poses of ours (``send``) and of the avatar's own rig
        (``send_rig``).
        """
        garments = self.garments[0] if len(self.garments) == 1 else self.garments
        return await DrapeStream.open(garment=garments, avatar=self.id, **self.client.reached, **self.options)

    def play(self, motion: str | Motion, *, trans: np.ndarray | None = None) -> list[np.ndarray]:
        """Drapes a motion, and returns the vertices (F, V, 3) [m] of each garment in the world."""
        clip = self.client.motion(motion, avatar=self.id) if isinstance(motion, str) else motion
        return self.client.drape_outfit(self.garments, clip, trans=trans, avatar=self.id, **self.options)

    def glb(self, motion: str | Motion, *, trans: np.ndarray | None = None, joints: int | None = None) -> bytes:
        """Returns a GLB of the garments over a motion, skinned to the nodes of the avatar's own file, with morph
        targets or with so many ``joints`` of each garment's own, in the unit of that file. It is one request, so the
        clip may not be longer than the service takes.
        """
        clip = self.client.motion(motion, avatar=self.id) if isinstance(motion, str) else motion
        more = {"rig": True, "joints": joints, "avatar": self.id}
        return self.client.drape_glb(self.garments, clip, trans=trans, **more, **self.options)

    def surface(self, motion: str | Motion, *, trans: np.ndarray | None = None) -> np.ndarray:
        """Returns the vertices (F, V, 3) [m] of the avatar's own surface over the motion."""
        clip = self.client.motion(motion, avatar=self.id) if isinstance(motion, str) else motion
        return self.client.posed_avatar(self.id, clip, trans=trans)
