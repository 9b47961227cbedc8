"""The skeleton of a character's file as the file has it: nodes, their own transforms, bind matrices of its skins.

Nodes are in the order of ``Character``, parents first. What hangs on no joint and carries none (meshes, cameras) is
left out where the skeleton is written again. With the weights on its joints and the triangles of its primitives it is
stored beside the wearer (``FileRig``), so that nobody has to read a stranger's file twice.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse

from drape.avatar.character import Character, Primitive, skin_of
from drape.errors import BodyError
from drape.files.gltf import GltfFile
from drape.files.gltf_json import Node
from drape.files.gltf_nodes import node_matrix, tree_of
from drape.files.packed import UNREADABLE, read_packed
from drape.geometry.rotations import matrix_to_quaternion
from drape.motion.joint_names import ancestors
from drape.motion.node_clip import nearest_rotations, world_transforms

PART = "file"  # In a wearer's file the names of these arrays begin with it.


@dataclass(frozen=True, eq=False)
class FileSkeleton:
    """The N nodes of a character's file, parents before children. Lengths are in the unit of the file.

    ``written`` has the name and the transform of each node as fields of glTF. ``parents`` (-1: none) and ``children``
    are indices of nodes, and ``tops`` are the nodes at the top of the scene. ``children`` and ``tops`` leave out
    meshes, cameras and what else carries no joint. ``moves`` (N, 3), ``turns`` (N, 4), unit quaternions wxyz, and
    ``scales`` (N, 3) are the local transforms. ``joints`` (J,) are the joints of the largest skin in its order, then
    those of other skins. ``binds`` (J, 4, 4) are their inverse bind matrices, all for the pose in which the largest
    skin was bound.
    """

    written: tuple[dict[str, Any], ...]
    parents: tuple[int, ...]
    children: tuple[tuple[int, ...], ...]
    tops: tuple[int, ...]
    moves: np.ndarray
    turns: np.ndarray
    scales: np.ndarray
    joints: np.ndarray
    binds: np.ndarray

    def world(self, moves: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Returns the world transforms (F, N, 4, 4), in the unit of the file, of nodes with the local translations
        ``moves`` (F, N, 3) and rotations ``turns`` (F, N, 4), quaternions wxyz. The scales are the file's."""
        return world_transforms(moves, turns, self.scales, self.parents)


@dataclass(frozen=True, eq=False)
class FileRig:
    """What is kept of a character's file, so that garments can be written on its rig.

    ``weights`` (V, J), sparse, are those of the character's surface on the joints of ``skeleton``. ``primitives`` have
    the file's triangles, and ``triangle`` (F,) is the index of each face among these, as in ``Character``.
    """

    skeleton: FileSkeleton
    weights: scipy.sparse.csr_matrix
    primitives: tuple[Primitive, ...]
    triangle: np.ndarray

    def arrays(self) -> dict[str, np.ndarray]:
        """Returns the rig as arrays for ``pack``, which ``load_file_rig`` reads; all names begin with ``file.``."""
        held = vars(self.skeleton)
        text = {key: value for key, value in held.items() if not isinstance(value, np.ndarray)}
        header = np.frombuffer(json.dumps(text | {"primitives": self.primitives}).encode(), dtype=np.uint8)
        found = {key: value for key, value in held.items() if key not in text} | {"header": header}
        found |= {"weight": self.weights.data.astype(np.float32), "column": self.weights.indices}
        found |= {"row": self.weights.indptr, "triangle": self.triangle.astype(np.int32)}
        return {f"{PART}.{key}": value for key, value in found.items()}


def load_file_rig(path: Path) -> FileRig:
    """Returns the rig in the stored file of a wearer at ``path``. Raises ``BodyError`` where it has none, or is
    damaged."""
    try:
        text, arrays = read_packed(path, part=PART)
        weights, column, row, triangle = (arrays.pop(key) for key in ("weight", "column", "row", "triangle"))
        primitives = tuple(Primitive(*one) for one in text.pop("primitives"))
        skeleton = FileSkeleton(**text, **arrays)
        over = scipy.sparse.csr_matrix((weights, column, row), (len(row) - 1, len(skeleton.joints)))
        return FileRig(skeleton, over, primitives, triangle)
    except UNREADABLE as error:
        expected, cure = "one that is stored with its rig", "Send the character again."
        raise BodyError(f"avatar {path.stem}", expected=expected, got=str(error)[:60], cure=cure) from error


def file_rig(file: GltfFile, character: Character) -> FileRig:
    """Returns the rig of ``file``, whose ``character`` was read before."""
    assert character.triangle is not None
    skeleton = file_skeleton(file)
    weights = scipy.sparse.csr_matrix(character.weights[:, skeleton.joints])
    return FileRig(skeleton, weights, character.primitives, character.triangle)


def file_skeleton(file: GltfFile) -> FileSkeleton:
    """Returns the skeleton of ``file``, which must have a skin."""
    nodes, document = file.document.nodes, file.document
    order, parents = tree_of(file)
    place = {node: number for number, node in enumerate(order)}
    used = dict.fromkeys(nodes[node].skin for node in order if nodes[node].skin is not None)
    skins = [skin_of(file, index) for index in used]
    largest, binds = max(skins, key=lambda skin: len(skin[0]))
    joints = list(dict.fromkeys(place[joint] for of in (largest, *(of for of, _ in skins)) for joint in of))
    held = [nodes[node] for node in order]
    kept = _kept(held, parents, set(joints))
    children = [[place[child] for child in node.children if place[child] in kept] for node in held]
    parts = [_parts(node, node_matrix(node)) for node in held]
    shown = document.scene is not None or document.scenes
    listed = file.item("scenes", document.scene or 0, "scene").nodes if shown else []
    for node in listed:
        file.item("nodes", node, "scenes.nodes")
    tops = list(dict.fromkeys(place[node] for node in listed if parents[place[node]] < 0))
    tops += [number for number, parent in enumerate(parents) if parent < 0 and number not in tops]
    moves, turns, scales = map(np.array, zip(*parts, strict=True))
    skeleton = FileSkeleton(
        tuple(_written(node, *own) for node, own in zip(held, parts, strict=True)),
        parents,
        tuple(map(tuple, children)),
        tuple(top for top in tops if top in kept),
        moves,
        turns,
        scales,
        np.array(joints),
        binds,
    )
    return replace(skeleton, binds=_all_binds(skeleton))


def _parts(node: Node, local: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Translation, quaternion wxyz and scale of a ``node``, whose transform ``local`` (4, 4) was checked; what a matrix
    shears is left out."""
    if node.matrix is None:
        turn = np.array(node.rotation, dtype=np.float64)[[3, 0, 1, 2]]
        length = np.linalg.norm(turn)
        turn = turn / length if length > 1e-6 else np.array([1.0, 0.0, 0.0, 0.0])
        return local[:3, 3], turn, np.array(node.scale, dtype=np.float64)
    scale = np.linalg.norm(local[:3, :3], axis=0)
    turn = local[:3, :3] / scale
    if np.linalg.det(turn) < 0.0:
        scale[0], turn[:, 0] = -scale[0], -turn[:, 0]
    return local[:3, 3], matrix_to_quaternion(nearest_rotations(turn)[None])[0], scale


def _written(node: Node, move: np.ndarray, turn: np.ndarray, scale: np.ndarray) -> dict[str, Any]:
    """Name and transform of ``node``."""
    parts = {"translation": move, "rotation": turn[[1, 2, 3, 0]], "scale": scale}
    there = {
        key: part.tolist() for key, part in parts.items() if key in node.model_fields_set or node.matrix is not None
    }
    return ({} if node.name is None else {"name": node.name}) | there


def _all_binds(skeleton: FileSkeleton) -> np.ndarray:
    """The inverse bind matrices (J, 4, 4) of all joints: the surface that is bound to the first ones is where joints of
    other skins move it too."""
    count = len(skeleton.binds)
    rest = skeleton.world(skeleton.moves[None], skeleton.turns[None])[0]
    known = {int(joint): row for row, joint in enumerate(skeleton.joints[:count])}
    more = []
    for joint in skeleton.joints[count:]:
        row = next((known[node] for node in ancestors(skeleton.parents, joint) if node in known), 0)
        more.append(np.linalg.inv(rest[joint]) @ rest[skeleton.joints[row]] @ skeleton.binds[row])
    return np.concatenate([skeleton.binds, *(one[None] for one in more)])


def _kept(nodes: list[Node], parents: tuple[int, ...], joints: set[int]) -> set[int]:
    """Places of the nodes that are joints or hold some, and of plain nodes below these."""
    kept = {node for joint in joints for node in ancestors(parents, joint)}
    for number, node in enumerate(nodes):
        if parents[number] in kept and node.mesh is None and node.camera is None:
            kept.add(number)
    return kept
