# SPDX-License-Identifier: Apache-2.0 OR GPL-3.0-or-later
# pyright: reportMissingImports=false
"""A bake, step by step: the character's file, its frames, the drape, the object."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Generator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from .armature import Y_UP, SceneCharacter
from .garment_object import baked, check_form
from .service_calls import Refusal, Service, Told, avatar_of, draped


class Step(NamedTuple):
    """How much is done, 0 to 1, and what goes on; ``waits``: for the service."""

    share: float
    words: str
    waits: bool = False


Steps = Generator[Step, None, Any]


def bake(context: Any, service: Service, asked: Any) -> Steps:
    """The steps of a bake of the scene's frames as the panel has ``asked`` for it; raises ``Refusal``.

    Nothing is added before the last step; the current frame is what it was after the last and wherever they end.
    """
    scene = context.scene
    frames, current = range(scene.frame_start, scene.frame_end + 1), scene.frame_current
    if not asked.garment:
        raise Refusal("garment", expected="a name", got="none", cure="Connect, then choose one of the service's.")
    check_form(asked.form)
    about: dict[str, Any] = {"garment": asked.garment, "fps": scene.render.fps / scene.render.fps_base}
    about |= {name: value for name in ("tier", "fabric") if (value := getattr(asked, name))}
    mesh = yield from _waited(lambda told: service.json("garments", asked.garment, "mesh"), 0.0, 0.02)
    turns, places = [], []
    try:
        scene.frame_set(frames[0])
        character = SceneCharacter(asked.armature)
        if character.body:
            who = yield from _waited(lambda told: service.json("bodies", character.body), 0.02, 0.2)
            pelvis, metres, rest = "pelvis", 1.0 / character.units, who["joints"][0]
        else:
            file = character.file(context)
            name = f"blender_{hashlib.sha256(file).hexdigest()[:24]}"  # another one after each change
            who = yield from _waited(lambda told: avatar_of(service, file, name, told), 0.02, 0.2)
            pelvis, metres, rest, about["avatar"] = who["joints"]["pelvis"], who["scale"], np.zeros(3), who["id"]
        for frame in frames:
            scene.frame_set(frame)
            turned, place = character.stands(context.evaluated_depsgraph_get(), pelvis)
            if character.body:
                turns.append([turn.to_exponential_map() for turn in turned])
            else:
                named = {bone: (*turn[1:], turn[0]) for bone, turn in zip(character.bones, turned, strict=True)}
                turns.append([named.get(node, (0.0, 0.0, 0.0, 1.0)) for node in who["nodes"]])
            places.append(place)
            yield Step(0.2 + 0.2 * len(places) / len(frames), f"Frame {frame}")
    finally:
        scene.frame_set(current)
    clip = np.array(turns), metres * np.array(places) - rest
    vertices = yield from _waited(lambda told: draped(service, about, *clip, told), 0.4, 0.95)
    vertices = vertices / metres @ np.array(Y_UP)
    baked(context, mesh, vertices, first=frames[0], form=asked.form, wearer=character.armature.name)


def _waited(work: Callable[[Told], Any], first: float, last: float) -> Steps:
    """Steps from the share ``first`` to ``last`` while ``work`` goes on beside Blender, and its answer. Who leaves the
    steps ends the work."""
    step, wanted, threads = Step(first, "Asking the service", waits=True), True, ThreadPoolExecutor(1)

    def told(share: float, words: str) -> None:
        nonlocal step
        if not wanted:
            raise CancelledError
        step = Step(first + share * (last - first), words, waits=True)

    ending = threads.submit(work, told)
    try:
        while not ending.done():
            yield step
    finally:
        wanted = False
        threads.shutdown(wait=False)
    return ending.result()
