"""The skeleton of a character's file as the file has it: nodes, their own transforms, bind matrices of its skins.

Nodes are in the order of ``Character``, parents first. What hangs on no joint and carries none (meshes, cameras) is
left out where the skeleton is written again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drape.avatar.character import skin_of, transform_of, tree_of
from drape.avatar.gltf import GltfFile
from drape.geometry.rotations import matrix_to_quaternion, quaternion_to_matrix


@dataclass(frozen=True, eq=False)
class FileSkeleton:
    """N nodes of a file.

    ``written`` are their name and transform as glTF has them, without matrices; ``parents`` (-1: none) and ``children``
    their places among each other. ``moves`` (N, 3), ``turns`` (N, 4), unit quaternions wxyz, and ``scales`` (N, 3) make
    their local transforms. ``joints`` (J,) and ``binds`` (J, 4, 4) are the joints of its largest skin in its order and
    their inverse bind matrices, then the joints of its other skins, bound as these. ``tops``: the nodes of its scene.
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
        """World transforms (F, N, 4, 4) of nodes with local ``moves`` (F, N, 3) and ``turns`` (F, N, 4), wxyz."""
        world = np.zeros((*moves.shape[:2], 4, 4))
        world[..., :3, :3] = quaternion_to_matrix(turns) * self.scales[:, None, :]
        world[..., :3, 3], world[..., 3, 3] = moves, 1.0
        for node, parent in enumerate(self.parents):
            if parent >= 0:
                world[:, node] = world[:, parent] @ world[:, node]
        return world


def file_skeleton(payload: bytes, *, label: str = "avatar") -> FileSkeleton:
    """The skeleton in the bytes of a GLB or VRM file that ``read_character`` took."""
    file = GltfFile(payload, label=label)
    order, parents = tree_of(file)
    place = {node: number for number, node in enumerate(order)}
    used = dict.fromkeys(file.item("nodes", node)["skin"] for node in order if "skin" in file.item("nodes", node))
    skins = [skin_of(file, index) for index in used]
    largest, binds = max(skins, key=lambda skin: len(skin[0]))
    joints = list(dict.fromkeys(place[joint] for of in (largest, *(of for of, _ in skins)) for joint in of))
    kept = _kept(file, order, parents, set(joints))
    children: list[list[int]] = [[] for _ in order]
    for number, node in enumerate(order):
        listed = (place[child] for child in file.item("nodes", node).get("children", ()))
        children[number] = [child for child in listed if child in kept]
    held = [file.item("nodes", node) for node in order]
    parts = [_parts(one, transform_of(file, node)) for one, node in zip(held, order, strict=True)]
    scenes, chosen = file.listed("scenes"), file.json.get("scene", 0)
    listed = scenes[chosen].get("nodes", ()) if isinstance(chosen, int) and 0 <= chosen < len(scenes) else ()
    tops = [place[node] for node in listed if node in place and parents[place[node]] < 0]
    tops += [number for number, parent in enumerate(parents) if parent < 0 and number not in tops]
    moves, turns, scales = (np.array(one) for one in zip(*parts, strict=True))
    found = FileSkeleton(
        tuple(_written(node, *own) for node, own in zip(held, parts, strict=True)),
        parents,
        tuple(tuple(one) for one in children),
        tuple(top for top in tops if top in kept),
        moves,
        turns,
        scales,
        np.array(joints),
        binds,
    )
    return replace(found, binds=_all_binds(found))


def _parts(node: dict[str, Any], local: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Translation, quaternion wxyz and scale of a ``node``, whose transform ``local`` (4, 4) was checked; what a matrix
    shears is left out."""
    if "matrix" not in node:
        turn = np.array(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), dtype=np.float64)[[3, 0, 1, 2]]
        length = np.linalg.norm(turn)
        turn = turn / length if length > 1e-6 else np.array([1.0, 0.0, 0.0, 0.0])
        return local[:3, 3], turn, np.array(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64)
    scale = np.linalg.norm(local[:3, :3], axis=0)
    turn = local[:3, :3] / scale
    if np.linalg.det(turn) < 0.0:
        scale[0], turn[:, 0] = -scale[0], -turn[:, 0]
    u, _, vt = np.linalg.svd(turn)
    return local[:3, 3], matrix_to_quaternion((u @ vt)[None])[0], scale


def _written(node: dict[str, Any], move: np.ndarray, turn: np.ndarray, scale: np.ndarray) -> dict[str, Any]:
    """Name and transform of ``node``."""
    parts = {"translation": move, "rotation": turn[[1, 2, 3, 0]], "scale": scale}
    there = {key: part.tolist() for key, part in parts.items() if key in node or "matrix" in node}
    return ({"name": str(node["name"])} if "name" in node else {}) | there


def _all_binds(skeleton: FileSkeleton) -> np.ndarray:
    """The inverse bind matrices (J, 4, 4) of all joints: the surface that is bound to the first ones is where joints of
    other skins move it too."""
    count = len(skeleton.binds)
    rest = skeleton.world(skeleton.moves[None], skeleton.turns[None])[0]
    known = {int(joint): row for row, joint in enumerate(skeleton.joints[:count])}
    more = []
    for joint in skeleton.joints[count:]:
        above = skeleton.parents[joint]
        while above >= 0 and above not in known:
            above = skeleton.parents[above]
        row = known.get(above, 0)
        more.append(np.linalg.inv(rest[joint]) @ rest[skeleton.joints[row]] @ skeleton.binds[row])
    return np.concatenate([skeleton.binds, *(one[None] for one in more)])


def _kept(file: GltfFile, order: list[int], parents: tuple[int, ...], joints: set[int]) -> set[int]:
    """Places of the nodes that are joints or hold some, and of plain nodes below these."""
    kept = set(joints)
    for joint in joints:
        above = parents[joint]
        while above >= 0 and above not in kept:
            kept.add(above)
            above = parents[above]
    for number, node in enumerate(order):
        if parents[number] in kept and not {"mesh", "camera"} & file.item("nodes", node).keys():
            kept.add(number)
    return kept
