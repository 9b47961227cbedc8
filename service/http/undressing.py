"""Finds the own clothes of a character that the garments of a request take off."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drape.avatar.own_clothes import halves_of
from drape.avatar.own_garments import MARK, Undressed, own_faces, undressed

if TYPE_CHECKING:
    from drape.avatar.wearer import Wearer
    from drape.stages.scene import Scene
    from service.guard.key_file import Client
    from service.state import State


async def undressed_avatar(avatar_id: str, scene: Scene, state: State, client: Client) -> tuple[Wearer, Undressed]:
    """Returns the wearer of the avatar ``avatar_id``, which wears ``scene``, and which faces of its own surface the
    garments take off and which skin is to be drawn instead."""
    wearer = await state.wearer(avatar_id, client)
    # The garments as they are on the standard body, but for those of its own clothes.
    standard = [(await state.garment(layer.id, client)).garment for layer in scene.layers if MARK not in layer.id]
    worn = [layer.garment for layer in scene.layers]
    cloth = [(garment.vertices, garment.faces) for garment in worn]
    halves = halves_of(standard, state.runtime.body)
    return wearer, await state.runtime.call_apart(undressed, wearer, own_faces(wearer, worn), cloth, halves)
