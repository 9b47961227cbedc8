# SPDX-License-Identifier: Apache-2.0 OR GPL-3.0-or-later
# pyright: reportMissingImports=false
"""The service's own body as an armature with a skin, and its sample motions as keyframes."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import bpy
from mathutils import Quaternion, Vector

from .armature import BODY, JOINTS, Y_UP
from .service_calls import GLB, Service


def add_our_body(context: Any, service: Service, motion: str) -> Any:
    """Adds the service's body to the scene and returns its armature, with keyframes of the sample clip ``motion`` from
    the scene's first frame on; none if ``motion`` is empty."""
    clip = service.json("motions", motion) if motion else {"poses": [], "trans": [], "fps": 1.0}
    body = service.json("bodies")[0]["id"]
    with service.request("GET", f"/bodies/{body}/mesh", accept=GLB) as answer, tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "body.glb"
        path.write_bytes(answer.read())
        bpy.ops.import_scene.gltf(filepath=str(path), disable_bone_shape=True)
    armature, scene = next(thing for thing in context.selected_objects if thing.type == "ARMATURE"), context.scene
    armature[BODY], armature.name = body, "Drape body"
    bones, axes = [armature.pose.bones[name] for name in JOINTS], []
    for bone in bones:
        bone.rotation_mode = "QUATERNION"
        axes.append(bone.bone.matrix_local.to_3x3().transposed() @ Y_UP.transposed())  # the service's to the bone's
    a_frame = scene.render.fps / scene.render.fps_base / clip["fps"]
    for number, (pose, trans) in enumerate(zip(clip["poses"], clip["trans"], strict=True)):
        frame = scene.frame_start + number * a_frame
        for bone, vector, to_bone in zip(bones, pose, axes, strict=True):
            bone.rotation_quaternion = Quaternion(to_bone @ Vector(vector))
            bone.keyframe_insert("rotation_quaternion", frame=frame)
        bones[0].location = axes[0] @ Vector(trans)
        bones[0].keyframe_insert("location", frame=frame)
    return armature
