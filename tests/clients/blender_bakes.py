# pyright: reportMissingImports=false
"""What ``test_blender.py`` has Blender do: PYTHON blender_bakes.py ZIP URL CHARACTER FOLDER, where PYTHON has ``bpy``.

Writes FOLDER/told.json, and FOLDER/body.npz and rig.npz with what stands in the scene in some frames, in its own axes.
"""

import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Quaternion, Vector

archive, url, character, folder = sys.argv[1:]
told: dict = {"blender": bpy.app.version_string}
scene, drape = bpy.context.scene, bpy.ops.drape


def placed(thing: Any) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and triangles (F, 3) of an object, as it is seen."""
    seen = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = seen.to_mesh()
    mesh.calc_loop_triangles()
    vertices, faces = np.empty(3 * len(mesh.vertices), "f4"), np.empty(3 * len(mesh.loop_triangles), "i4")
    mesh.vertices.foreach_get("co", vertices)
    mesh.loop_triangles.foreach_get("vertices", faces)
    world = np.array(seen.matrix_world)
    return vertices.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3], faces.reshape(-1, 3)


def show(name: str, garment: Any, skin: Any, frames: list[int]) -> None:
    """Writes ``garment`` and ``skin`` in ``frames``."""
    seen = []
    for frame in frames:
        scene.frame_set(frame)
        seen.append((placed(garment)[0], placed(skin)[0]))
    cloth, body = (np.array(each) for each in zip(*seen, strict=True))
    np.savez(Path(folder) / f"{name}.npz", cloth=cloth, body=body, faces=placed(skin)[1])


def refused(call: Any) -> str:
    """The sentence with which an operator refuses."""
    try:
        call()
    except RuntimeError as error:
        return str(error).strip()
    return ""


def garment_of(name: str) -> Any:
    """The object of a garment."""
    return next(one for one in scene.objects if one.get("drape_worn", "").endswith(f"/{name}"))


def clear() -> None:
    """Takes everything out of the scene."""
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)


def skin() -> Any:
    """The mesh that bones move."""
    return next(one for one in scene.objects if any(each.type == "ARMATURE" for each in one.modifiers))


bpy.ops.extensions.package_install_files(filepath=archive, repo="user_default", enable_on_install=True)
addon = next(one.module for one in bpy.context.preferences.addons if one.module.endswith(".drape"))
module, held = sys.modules[addon], bpy.context.preferences.addons[addon].preferences
clear()

# Our body in a walk, thirty frames a second.
told["nothing chosen"] = refused(drape.bake)
held.url = url
drape.connect()
told["known"] = module.known
scene.render.fps, scene.frame_start, scene.frame_end = 30, 1, 60
scene.drape.motion, scene.drape.garment = "walk", "tshirt"
told["no armature"] = refused(drape.bake)
drape.add_body()
scene.frame_set(7)
started = time.monotonic()
drape.bake()
told["body_s"], told["frame after"] = time.monotonic() - started, scene.frame_current
tshirt = garment_of("tshirt")
told["keys"], told["uv"] = len(tshirt.data.shape_keys.key_blocks), len(tshirt.data.uv_layers)
show("body", tshirt, skin(), [0, 1, 2, 31, 60, 61])
scene.frame_set(30, subframe=0.5)
between = placed(tshirt)[0]
sides = []
for frame in (30, 31):
    scene.frame_set(frame)
    sides.append(placed(tshirt)[0])
told["between_m"] = float(np.abs(between - 0.5 * (sides[0] + sides[1])).max())

# Again: the same object, its materials kept; refusals; and what is left of a bake that is ended.
red = bpy.data.materials.new("red")
tshirt.data.materials[0] = red
scene.frame_end = 5
drape.bake()
told["again"] = [len(tshirt.data.shape_keys.key_blocks), tshirt.data.materials[0].name, len(scene.objects)]
scene.drape.garment = "gone"
told["garment gone"] = refused(drape.bake)
scene.drape.garment, scene.drape.form = "skirt", "PC2"
told["unsaved"] = refused(drape.bake)
scene.drape.form, before = "KEYS", set(bpy.data.objects)
scene.frame_set(3)
steps = module.bake(bpy.context, module.service_of(bpy.context), scene.drape)
while next(steps).words != "Frame 4":
    pass
steps.close()
told["ended"] = [scene.frame_current, before == set(bpy.data.objects)]
bpy.ops.ed.undo_push(message="before")
drape.bake()
bpy.ops.ed.undo_push(message="baked")
told["baked"] = any(one.get("drape_worn", "").endswith("/skirt") for one in bpy.data.objects)
bpy.ops.ed.undo()
told["undone"] = any(one.get("drape_worn", "").endswith("/skirt") for one in bpy.data.objects)

# A character of its own on a stage that turns it, makes it larger and moves; 24 frames a second, from frame 101.
clear()
scene = bpy.context.scene
bpy.ops.import_scene.gltf(filepath=character)
armature = next(one for one in scene.objects if one.type == "ARMATURE")
top = armature
while top.parent:
    top = top.parent
stage = bpy.data.objects.new("stage", None)
scene.collection.objects.link(stage)
top.parent, stage.rotation_euler, stage.scale = stage, (0.0, 0.0, 2.2), (1.1, 1.1, 1.1)
scene.render.fps, scene.frame_start, scene.frame_end = 24, 101, 160
for frame in range(101, 161, 6):
    stage.location = (3.0, -2.0 - 0.02 * (frame - 101), 0.5)
    stage.keyframe_insert("location", frame=frame)
    for bone, share in (("mixamorig:LeftArm", 0.6), ("mixamorig:RightArm", -0.6), ("mixamorig:LeftUpLeg", 0.4)):
        posed = armature.pose.bones[bone]
        posed.rotation_mode = "QUATERNION"
        axis = posed.bone.matrix_local.to_3x3().transposed() @ Vector((1.0, 0.0, 0.0))
        posed.rotation_quaternion = Quaternion(axis, share * math.sin((frame - 101) / 10.0))
        posed.keyframe_insert("rotation_quaternion", frame=frame)
bpy.ops.wm.save_as_mainfile(filepath=str(Path(folder) / "scene.blend"))
scene.drape.armature, scene.drape.garment, scene.drape.form = armature, "tshirt", "PC2"
started = time.monotonic()
drape.bake()
told["rig_s"] = time.monotonic() - started
show("rig", garment_of("tshirt"), skin(), [101, 130, 160])
started = time.monotonic()
drape.bake()
told["rig_again_s"] = time.monotonic() - started
stage.scale = (1.1, 1.1, 1.5)
told["stretched"] = refused(drape.bake)
stage.scale = (1.1, 1.1, 1.1)
skin().hide_set(True)
told["hidden"] = refused(drape.bake)
held.url = "https://drape.example"
told["elsewhere"] = refused(drape.bake)
(Path(folder) / "told.json").write_text(json.dumps(told))
