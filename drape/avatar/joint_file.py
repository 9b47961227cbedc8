"""Garments with joints of their own in a GLB: on the nodes of a character's rig, or in the character's own file.

A joint below the rig's joint j, with inverse bind matrix B_j, is at B_j S P in its parent: S is its motion seen from j,
and P puts it at its pivot in the bind pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drape.avatar.affine_maps import compose
from drape.avatar.distilled import Distilled, DrapedClip
from drape.avatar.rig_motion import RigMotion
from drape.avatar.rig_weights import HEAVIEST
from drape.export.glb import Shape, add_shape, split_seams, vertex_normals
from drape.export.glb_file import VERTEX_BUFFER, Channel, GlbFile
from drape.export.root_motion import quaternion_keys
from drape.export.surface import Surface
from drape.geometry.rotations import matrix_to_quaternion
from drape.motion.node_clip import nearest_rotations

WEIGHT_STEPS = 65535


@dataclass(frozen=True, eq=False)
class Jointed:
    """A garment with joints of its own for a file: its mesh ``surface``, its skinning ``distilled``, and its
    ``colour``, linear red, green, blue and opacity."""

    surface: Surface
    distilled: Distilled
    colour: tuple[float, float, float, float]


def add_clip(
    file: GlbFile,
    layers: Sequence[Jointed],
    draped: Sequence[np.ndarray],
    motion: RigMotion,
    nodes: dict[int, int],
    scale: float,
) -> None:
    """Adds the garments ``layers`` to ``file``, and an animation of the rig's joints and of their own over ``motion``.

    ``draped`` are the vertices [m] (F, V, 3) of each garment in the world, to which its joints are fitted. The
    skeleton's node n is the node ``nodes[n]`` of ``file``. ``scale``: metres per unit of the file.
    """
    channels: list[Channel] = []
    for layer, vertices in zip(layers, draped, strict=True):
        own = add_jointed(file, layer, nodes)
        moves = layer.distilled.fitted(DrapedClip(vertices, motion), scale)
        turns, places = node_motions(layer.distilled, layer.distilled.local(motion, moves))
        for number, node in enumerate(own):
            channels.append((node, "rotation", quaternion_keys(turns[:, number])))
            channels.append((node, "translation", places[:, number].astype(np.float32)))
    motion.animate(file, nodes, channels)


def add_jointed(file: GlbFile, layer: Jointed, nodes: dict[int, int]) -> list[int]:
    """Adds mesh and skin of ``layer`` to ``file``, and nodes for its own joints below those of the rig. Returns the
    indices of these nodes, which stand where nothing moves the joints. The skeleton's node n is the node ``nodes[n]``
    of ``file``."""
    distilled, surface = layer.distilled, layer.surface
    turns, places = node_motions(distilled, distilled.still[None])
    scales = 1.0 / _scales(distilled)
    own = []
    for number, parent in enumerate(distilled.parents):
        node = {"name": f"{surface.name}_{number:02d}", "translation": places[0, number].tolist()}
        node["rotation"] = quaternion_keys(turns[:, number])[0].tolist()
        if abs(scales[number] - 1.0) > 1e-6:
            node["scale"] = [float(scales[number])] * 3
        own.append(file.add("nodes", node))
        above = file.json["nodes"][nodes[int(distilled.joints[parent])]]
        above.setdefault("children", []).append(own[-1])
    skin = _add_skin(file, distilled, nodes, own)
    corners = split_seams(surface)
    parts = _mesh(file, distilled, surface.faces, corners.source)
    add_shape(file, surface, corners, Shape([parts], {"skin": skin}), 1, 1.0, layer.colour)
    return own


def node_motions(distilled: Distilled, moves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the local rotations (F, E, 4), quaternions wxyz, and translations (F, E, 3), in the unit of the file, of
    the nodes of a garment's own joints. ``moves`` (F, E, 3, 4) are the joints' motions seen from their parents
    (``Distilled.local``)."""
    at = compose(compose(distilled.binds[distilled.parents], moves), _at(distilled.pivots))
    # Parents of a character may shear a little, or be mirrored.
    return matrix_to_quaternion(nearest_rotations(at[..., :3])), at[..., 3]


def _scales(distilled: Distilled) -> np.ndarray:
    """The scales (E,) of the nodes of the parents in the bind pose."""
    return 1.0 / np.cbrt(np.abs(np.linalg.det(distilled.binds[distilled.parents, :, :3])))


def _at(points: np.ndarray) -> np.ndarray:
    """Maps (E, 3, 4) that move the origin to each of ``points`` (E, 3)."""
    return np.concatenate([np.broadcast_to(np.eye(3), (len(points), 3, 3)), points[..., None]], axis=-1)


def _add_skin(file: GlbFile, distilled: Distilled, nodes: dict[int, int], own: Sequence[int]) -> int:
    """The skin in ``file``: the rig's joints, then the garment's ``own``."""
    columns = np.zeros((len(distilled.joints) + distilled.count, 4, 4))
    columns[:, :3] = np.concatenate([distilled.binds, _at(-distilled.pivots)])
    columns[:, 3] = [0.0, 0.0, 0.0, 1.0]
    joints = [*(nodes[int(joint)] for joint in distilled.joints), *own]
    binds = file.array(np.swapaxes(columns, -1, -2).astype(np.float32))  # glTF stores matrices column by column.
    return file.add("skins", {"joints": joints, "inverseBindMatrices": binds})


def _mesh(file: GlbFile, distilled: Distilled, faces: np.ndarray, source: np.ndarray) -> dict[str, int]:
    """The accessors of the mesh in the bind pose, whose row i is vertex ``source[i]``."""
    bones = np.argsort(-distilled.weights, axis=1, kind="stable")[:, :HEAVIEST]
    kept = np.take_along_axis(distilled.weights, bones, axis=1)
    steps = np.rint(kept * WEIGHT_STEPS).astype(np.int64)
    steps[:, 0] += WEIGHT_STEPS - steps.sum(axis=1)
    bones = np.where(steps > 0, bones, 0).astype(np.uint8)
    rest = distilled.rest.astype(np.float32)
    normals = vertex_normals(rest[None], faces)[0]
    return {
        "POSITION": file.array(rest[source], target=VERTEX_BUFFER, bounds=True),
        "NORMAL": file.array(normals[source], target=VERTEX_BUFFER),
        "JOINTS_0": file.array(bones[source], target=VERTEX_BUFFER),
        "WEIGHTS_0": file.array(steps.astype(np.uint16)[source], target=VERTEX_BUFFER, normalized=True),
    }
