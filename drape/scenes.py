"""Garments over a motion, with the character that wears them, as files for programs that do not know our rigs.

shirt = drape.load().wear("tshirt", on="me.vrm", alive=True)
Path("walking.usdz").write_bytes(drape.usd(shirt, "walk"))
for name, content in drape.vat(shirt, "walk", name="walking").items():
    Path(name).write_bytes(content)
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from drape.avatar.below_cloth import keep_below
from drape.avatar.character_surface import moving_character
from drape.avatar.rig_motion import RigClip, rig_motion
from drape.export.clips import moving_layers
from drape.export.surface import MovingGarment
from drape.export.usd_stage import check_usd, usd_file
from drape.export.vat import check_vat, vat_files
from drape.library import Worn
from drape.motion.clip import MotionClip

Motion = str | Path | MotionClip
FPS = 30.0


def usd(worn: Worn, motion: Motion, *, fps: float = FPS) -> bytes:
    """Returns the bytes of a .usdz of the ``scene`` over ``motion``, pictures included; raises ``Unavailable`` without
    usd-core."""
    check_usd()
    return usd_file(scene(worn, motion, fps=fps), fps, ".usdz")


def vat(worn: Worn, motion: Motion, *, name: str = "clip", fps: float = FPS) -> dict[str, bytes]:
    """Returns the ``scene`` over ``motion`` as a vertex animation texture (``drape.export.vat``): the bytes of three
    files by their names, which begin with ``name``. Raises ``Unavailable`` without OpenEXR."""
    check_vat()
    return vat_files(scene(worn, motion, fps=fps), fps, name)


def scene(worn: Worn, motion: Motion, *, fps: float = FPS, as_recorded: bool = False) -> list[MovingGarment]:
    """Returns the meshes of a scene over ``motion``: the character's own surface, if one wears the garments, then the
    garments that are ``worn``.

    ``motion``, ``fps`` and ``as_recorded`` are those of ``Worn.placed``. The surface has the faces that
    ``Worn.character_file`` keeps; where cloth covers it, it is kept below the cloth in every frame.
    """
    clip = worn.placed(motion, fps=fps, as_recorded=as_recorded)
    vertices = np.stack([frame.vertices for frame in worn.play(clip, fps=clip.fps, as_recorded=True)])
    layers = moving_layers(worn.garments, vertices)
    if worn.wearer is None:
        return layers
    wearer, rig = worn.on_rig()
    on_rig = rig_motion(RigClip(*wearer.to_rig(clip.poses, clip.trans), clip.fps), wearer, rig.skeleton)
    parts = moving_character(worn.character_file, on_rig, wearer.scale)
    return [*keep_below(parts, [(layer.vertices, layer.faces) for layer in worn.layers], layers), *layers]
