"""What the garments of a request take off a character."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drape.avatar.own_clothes import halves_of
from drape.avatar.own_garments import MARK, Undressed, own_faces, undress

if TYPE_CHECKING:
    from drape.avatar.wearer import Wearer
    from drape.stages.scene import Scene
    from service.guard.key_file import Client
    from service.state import State


async def undressed_avatar(avatar_id: str, scene: Scene, state: State, client: Client) -> tuple[Wearer, Undressed]:
    """Returns the avatar that wears ``scene``, and what its garments leave of its own surface to be drawn."""
    wearer = await state.wearer(avatar_id, client)
    ours = [(await state.garment(one.id, client)).garment for one in scene.layers if MARK not in one.id]
    worn = [one.garment for one in scene.layers]
    cloth = [(one.vertices, one.faces) for one in worn]
    halves = halves_of(ours, state.runtime.body)
    return wearer, await state.runtime.call_apart(undress, wearer, own_faces(wearer, worn), cloth, halves)
