"""The body in a GLB: a skinned mesh with its 24 joints, still or in motion.

It has its four heaviest bones per vertex, which is what players support (the shipped body's fifth and sixth weights sum
to at most 0.034).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES, PARENTS
from drape.export.glb import flat_indices, vertex_normals
from drape.export.glb_file import INDEX_BUFFER, VERTEX_BUFFER, GlbFile
from drape.export.root_motion import keys

BODY_COLOUR = (0.80, 0.70, 0.63, 1.0)


def add_body(
    file: GlbFile,
    body: BodyModel,
    betas: np.ndarray,
    poses: np.ndarray | None = None,
    trans: np.ndarray | None = None,
    fps: float = 30.0,
) -> None:
    """Adds the body of shape ``betas`` (S,) to ``file``, with its 24 joints as a skeleton. It is animated at ``fps``
    frames a second if SMPL ``poses`` (F, 24, 3) [rad] and root translations ``trans`` [m] (F, 3) are given."""
    rest, joints = body.rest_vertices(betas), body.rest_joints(betas)
    first = len(file.json["nodes"])
    for joint, (name, parent) in enumerate(zip(JOINT_NAMES, PARENTS, strict=True)):
        offset = joints[joint] - (joints[parent] if parent >= 0 else 0.0)
        node: dict[str, Any] = {"name": name, "translation": offset.tolist()}
        children = [first + child for child, other in enumerate(PARENTS) if other == joint]
        if children:
            node["children"] = children
        file.add("nodes", node)
    file.json["scenes"][0]["nodes"].append(first)
    binds = np.tile(np.eye(4, dtype=np.float32), (len(joints), 1, 1))
    binds[:, 3, :3] = -joints  # glTF stores matrices column by column, so the translation is the last row.
    bones, weights = heaviest_bones(body)
    attributes = {
        "POSITION": file.array(rest.astype(np.float32), target=VERTEX_BUFFER, bounds=True),
        "NORMAL": file.array(vertex_normals(rest[None], body.faces)[0], target=VERTEX_BUFFER),
        "JOINTS_0": file.array(bones, target=VERTEX_BUFFER),
        "WEIGHTS_0": file.array(weights, target=VERTEX_BUFFER),
    }
    primitive = {
        "attributes": attributes,
        "indices": file.array(flat_indices(body.faces, body.vertex_count), target=INDEX_BUFFER),
        "material": file.material("body", BODY_COLOUR),
    }
    skin = file.add(
        "skins",
        {
            "joints": [first + joint for joint in range(len(joints))],
            "skeleton": first,
            "inverseBindMatrices": file.array(binds),
        },
    )
    file.node(
        {"name": body.name, "mesh": file.add("meshes", {"name": body.name, "primitives": [primitive]}), "skin": skin}
    )
    if poses is None or trans is None:
        return
    xyzw = keys(poses)
    channels = [(first + joint, "rotation", xyzw[:, joint]) for joint in range(len(joints))]
    channels.append((first, "translation", (joints[0] + trans).astype(np.float32)))
    file.animate(len(poses), fps, channels)


def heaviest_bones(body: BodyModel) -> tuple[np.ndarray, np.ndarray]:
    """Returns the four heaviest bones of each vertex, uint8 (V, 4), and their weights (V, 4), float32, which sum to
    one."""
    order = np.argsort(-body.weights, axis=1, kind="stable")[:, :4]
    weights = np.take_along_axis(body.weights, order, axis=1)
    weights = (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
    return np.where(weights > 0.0, order, 0).astype(np.uint8), weights
