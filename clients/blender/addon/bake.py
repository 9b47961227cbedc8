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
from .service_calls import Progress, Refusal, Service, avatar_of, draped


class Step(NamedTuple):
    """The state of a bake: the ``share`` that is done, 0 to 1, and ``words`` on what goes on; ``waits``: whether it
    waits for the service."""

    share: float
    words: str
    waits: bool = False


Steps = Generator[Step, None, Any]


def bake(context: Any, service: Service, settings: Any) -> Steps:
    """Bakes the scene's frames by the panel's ``settings``, and yields a ``Step`` now and then. Raises ``Refusal``.

    Adds the garment's object at the end. Puts the scene's current frame back, also where the caller stops early.
    """
    scene = context.scene
    frames, current = range(scene.frame_start, scene.frame_end + 1), scene.frame_current
    if not settings.garment:
        raise Refusal("garment", expected="a name", got="none", cure="Connect, then choose one of the service's.")
    check_form(settings.form)
    about: dict[str, Any] = {"garment": settings.garment, "fps": scene.render.fps / scene.render.fps_base}
    about |= {name: value for name in ("tier", "fabric") if (value := getattr(settings, name))}
    mesh = yield from _waited(lambda progress: service.json("garments", settings.garment, "mesh"), 0.0, 0.02)
    turns, places = [], []
    try:
        scene.frame_set(frames[0])
        character = SceneCharacter(settings.armature)
        if character.body:
            who = yield from _waited(lambda progress: service.json("bodies", character.body), 0.02, 0.2)
            pelvis, metres, rest = "pelvis", 1.0 / character.units, who["joints"][0]
        else:
            file = character.file(context)
            name = f"blender_{hashlib.sha256(file).hexdigest()[:24]}"  # another one after each change
            who = yield from _waited(lambda progress: avatar_of(service, file, name, progress), 0.02, 0.2)
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
    vertices = yield from _waited(lambda progress: draped(service, about, *clip, progress), 0.4, 0.95)
    vertices = vertices / metres @ np.array(Y_UP)
    baked(context, mesh, vertices, first=frames[0], form=settings.form, wearer=character.armature.name)


def _waited(work: Callable[[Progress], Any], first: float, last: float) -> Steps:
    """Yields steps from the share ``first`` to ``last`` while ``work`` runs beside Blender; returns its answer. Leaving
    the steps ends the work."""
    step, wanted, threads = Step(first, "Asking the service", waits=True), True, ThreadPoolExecutor(1)

    def progress(share: float, words: str) -> None:
        nonlocal step
        if not wanted:
            raise CancelledError
        step = Step(first + share * (last - first), words, waits=True)

    ending = threads.submit(work, progress)
    try:
        while not ending.done():
            yield step
    finally:
        wanted = False
        threads.shutdown(wait=False)
    return ending.result()
