"""A user's character as its file has it: nodes at rest, skinned surface, which nodes VRM calls which bones.

Everything is in the file's own units and axes, in the pose of its nodes. That pose may differ from the one in which
the surface was bound to the skeleton; the surface is where the skin puts it, so vertices are skinned once here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse

from drape.avatar.gltf import GltfFile
from drape.errors import MeshError
from drape.geometry.rotations import quaternion_to_matrix

MOST_JOINTS = 400
MOST_VERTICES = 400_000
LEAST_VERTICES = 100
WELD_SHARE = 1e-5  # of the height: vertices nearer to each other are one, split for texture coordinates
TRIANGLES = 4


class Primitive(NamedTuple):
    """One primitive of the skinned mesh of ``node``, which is its number in the file: the node's ``name``, its place
    among the mesh's primitives, and how many ``triangles`` it has."""

    node: int
    name: str
    primitive: int
    triangles: int


@dataclass(frozen=True, eq=False)
class Character:
    """Nodes and surface of a character.

    ``names`` and ``parents`` (-1: none) of N nodes, parents before children; ``world`` (N, 4, 4) their rest transforms
    in the file's space.
    ``vertices`` (V, 3) at rest, ``faces`` (F, 3), ``weights`` (V, N), rows sum to one. ``humanoid``: VRM's bones and
    their places among the N; empty where the file is no VRM. ``vrm``: "0", "1" or "". ``primitives`` have the file's
    triangles one after the other; ``triangle`` (F,) says which of these each face is.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    world: np.ndarray
    vertices: np.ndarray
    faces: np.ndarray
    weights: scipy.sparse.csr_matrix
    humanoid: dict[str, int]
    vrm: str
    primitives: tuple[Primitive, ...] = ()
    triangle: np.ndarray | None = None

    @property
    def places(self) -> np.ndarray:
        """Where the nodes are at rest (N, 3)."""
        return self.world[:, :3, 3]


def read_character(payload: bytes, *, label: str = "avatar") -> Character:
    """The character in the bytes of a GLB or VRM file; refuses (``MeshError``) what has no skinned surface."""
    file = GltfFile(payload, label=label)
    order, parents = tree_of(file)
    place = {node: number for number, node in enumerate(order)}
    world = np.stack([transform_of(file, node) for node in order])
    for number, parent in enumerate(parents):
        if parent >= 0:
            world[number] = world[parent] @ world[number]
    parts = [_parts(file, node, place, world) for node in order if "skin" in file.item("nodes", node)]
    if not any(parts):
        raise MeshError(
            f"{label}: skin",
            expected="a surface that a skeleton moves",
            got="no mesh with a skin",
            cure="Export the character with its armature and its skin weights.",
        )
    vertices, faces, weights = _joined([part for one in parts for part in one.values()], len(order))
    _check_size(vertices, faces, weights, label)
    humanoid, version = _vrm_bones(file, place)
    names = tuple(str(file.item("nodes", node).get("name", ""))[:120] for node in order)
    primitives = tuple(primitive for one in parts for primitive in one)
    vertices, faces, weights, triangle = _welded(vertices, faces, weights)
    return Character(
        names, parents, world, vertices, faces, weights, humanoid, version, primitives, triangle
    )  # fmt: skip


def tree_of(file: GltfFile) -> tuple[list[int], tuple[int, ...]]:
    """The file's nodes, parents first, and the place of each one's parent among them."""
    count = len(file.listed("nodes"))
    parent = np.full(count, -1)
    for node in range(count):
        for child in file.item("nodes", node).get("children", ()):
            file.item("nodes", child)
            if parent[child] >= 0:
                got = f"node {child} under two"
                raise MeshError(f"{file.label}: nodes", expected="a tree", got=got, cure="Export the character again.")
            parent[child] = node
    order, waiting = [], [node for node in range(count) if parent[node] < 0][::-1]
    while waiting:
        node = waiting.pop()
        order.append(node)
        waiting.extend(reversed(file.item("nodes", node).get("children", ())))
    if len(order) < count:
        got = f"{count - len(order)} nodes in a ring"
        raise MeshError(f"{file.label}: nodes", expected="a tree", got=got, cure="Export the character again.")
    place = {node: number for number, node in enumerate(order)}
    return order, tuple(place[int(parent[node])] if parent[node] >= 0 else -1 for node in order)


def transform_of(file: GltfFile, node: int) -> np.ndarray:
    """The transform (4, 4) of a node relative to its parent."""
    held, found = file.item("nodes", node), np.eye(4)
    try:
        if "matrix" in held:
            found = np.array(held["matrix"], dtype=np.float64).reshape(4, 4).T
        else:
            x, y, z, w = (float(one) for one in held.get("rotation", (0.0, 0.0, 0.0, 1.0)))
            length = np.sqrt(x * x + y * y + z * z + w * w)
            turn = quaternion_to_matrix(np.array([w, x, y, z]) / max(length, 1e-12)) if length > 1e-6 else np.eye(3)
            found[:3, :3] = turn * np.array(held.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64).reshape(3)
            found[:3, 3] = np.array(held.get("translation", (0.0, 0.0, 0.0)), dtype=np.float64).reshape(3)
        fits = bool(np.isfinite(found).all()) and float(np.abs(found).max()) < 1e9
    except (TypeError, ValueError):
        fits = False
    if not fits or abs(np.linalg.det(found[:3, :3])) < 1e-18:
        name, cure = f"{file.label}: nodes[{node}]", "Apply the transforms of the armature and export again."
        raise MeshError(name, expected="a transform that can be undone", got="another one", cure=cure)
    return found


Part = tuple[np.ndarray, np.ndarray, scipy.sparse.csr_matrix]


def _parts(file: GltfFile, number: int, place: dict[int, int], world: np.ndarray) -> dict[Primitive, Part]:
    """Vertices, faces and weights over nodes of each primitive of triangles of the skinned mesh of a node."""
    node = file.item("nodes", number)
    mesh = file.item("meshes", node.get("mesh"))
    joints, binds = skin_of(file, node["skin"])
    rows = np.array([place[joint] for joint in joints])
    moves = world[rows] @ binds
    found = {}
    for index, primitive in enumerate(mesh.get("primitives", ())):
        if primitive.get("mode", TRIANGLES) == TRIANGLES and "JOINTS_0" in primitive.get("attributes", {}):
            part = _primitive(file, primitive, rows, moves, len(world))
            found[Primitive(number, str(node.get("name", ""))[:120], index, len(part[1]))] = part
    return found


def skin_of(file: GltfFile, index: Any) -> tuple[list[int], np.ndarray]:
    """The nodes of the joints of skin ``index`` in the file's order, and their inverse bind matrices (J, 4, 4)."""
    skin = file.item("skins", index)
    joints = skin.get("joints", [])
    if not isinstance(joints, list) or not 0 < len(joints) <= MOST_JOINTS:
        raise MeshError(
            f"{file.label}: skin",
            expected=f"1 to {MOST_JOINTS} joints",
            got=str(len(joints)) if isinstance(joints, list) else type(joints).__name__,
            cure="Export the deforming bones alone.",
        )
    for joint in joints:
        file.item("nodes", joint)
    binds = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
    if "inverseBindMatrices" in skin:
        flat = file.array(skin["inverseBindMatrices"])
        if flat.shape != (len(joints), 16):
            got = f"shape {flat.shape}"
            name, cure = f"{file.label}: inverseBindMatrices", "Export the character again."
            raise MeshError(name, expected=f"({len(joints)}, 16)", got=got, cure=cure)
        binds = flat.astype(np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
    return joints, np.array(binds)


def _primitive(file: GltfFile, primitive: dict[str, Any], rows: np.ndarray, moves: np.ndarray, nodes: int) -> Part:
    """One primitive, its vertices where ``moves`` (J, 4, 4) of the joints put them."""
    held = primitive["attributes"]
    points = file.array(held.get("POSITION")).astype(np.float64)
    count = len(points)
    faces = file.array(primitive["indices"]) if "indices" in primitive else np.arange(count - count % 3)[:, None]
    faces = faces[: len(faces) - len(faces) % 3].astype(np.int64).reshape(-1, 3)
    sets = [k for k in range(4) if f"JOINTS_{k}" in held and f"WEIGHTS_{k}" in held]
    joint = np.concatenate([file.array(held[f"JOINTS_{k}"]) for k in sets], axis=1).astype(np.int64)
    weight = np.concatenate([file.array(held[f"WEIGHTS_{k}"]) for k in sets], axis=1).astype(np.float64)
    fits = points.shape[1] == 3 and joint.shape == weight.shape and len(joint) == count
    weight = np.maximum(weight, 0.0)
    if not fits or (len(faces) and faces.max() >= count) or np.where(weight > 0.0, joint, 0).max() >= len(rows):
        name, cure = f"{file.label}: mesh", "Export the character again."
        raise MeshError(name, expected="positions, joints and weights that fit together", got="others", cure=cure)
    total = weight.sum(axis=1, keepdims=True)
    weight = np.where(total > 1e-6, weight / np.maximum(total, 1e-12), np.eye(1, weight.shape[1]))
    joint = np.where(weight > 0.0, joint, 0)
    spread = np.repeat(np.arange(count), joint.shape[1])
    over_joints = scipy.sparse.csr_matrix((weight.reshape(-1), (spread, joint.reshape(-1))), (count, len(rows)))
    blended = (over_joints @ moves.reshape(len(rows), 16)).reshape(count, 4, 4)
    placed = np.einsum("vab,vb->va", blended[:, :3, :3], points) + blended[:, :3, 3]
    onto = scipy.sparse.csr_matrix((np.ones(len(rows)), (np.arange(len(rows)), rows)), (len(rows), nodes))
    return placed, faces, scipy.sparse.csr_matrix(over_joints @ onto)


def _joined(parts: list[Part], nodes: int) -> Part:
    """``parts`` as one surface."""
    start = np.cumsum([0, *(len(points) for points, _, _ in parts)])
    faces = [faces + first for (_, faces, _), first in zip(parts, start, strict=False)]
    weights = scipy.sparse.csr_matrix(scipy.sparse.vstack([weights for _, _, weights in parts]))
    return np.concatenate([points for points, _, _ in parts]), np.concatenate(faces), weights


def _check_size(vertices: np.ndarray, faces: np.ndarray, weights: scipy.sparse.csr_matrix, label: str) -> None:
    if not LEAST_VERTICES <= len(vertices) <= MOST_VERTICES or len(faces) < LEAST_VERTICES:
        got = f"{len(vertices):,} vertices and {len(faces):,} triangles"
        wanted = f"{LEAST_VERTICES} to {MOST_VERTICES:,} vertices in triangles"
        raise MeshError(f"{label}: mesh", expected=wanted, got=got, cure="Export a whole character, decimated.")
    used = int((np.diff(weights.tocsc().indptr) > 0).sum())
    if used > MOST_JOINTS:
        cure = "Export the deforming bones alone."
        raise MeshError(f"{label}: skin", expected=f"at most {MOST_JOINTS} joints", got=str(used), cure=cure)


def _vrm_bones(file: GltfFile, place: dict[int, int]) -> tuple[dict[str, int], str]:
    """VRM's bones -> places of nodes, and the version of VRM."""
    extensions = file.json.get("extensions", {})
    extensions = extensions if isinstance(extensions, dict) else {}
    try:
        if "VRMC_vrm" in extensions:
            bones = extensions["VRMC_vrm"]["humanoid"]["humanBones"]
            return {str(bone): place[held["node"]] for bone, held in bones.items()}, "1"
        if "VRM" in extensions:
            bones = extensions["VRM"]["humanoid"]["humanBones"]
            return {str(held["bone"]): place[held["node"]] for held in bones if held.get("node", -1) >= 0}, "0"
    except (KeyError, TypeError, AttributeError) as error:
        cure = "Export the VRM again, or send it as a plain GLB."
        raise MeshError(
            f"{file.label}: VRM", expected="humanBones of nodes", got=repr(error)[:60], cure=cure
        ) from error
    return {}, ""


def _welded(
    vertices: np.ndarray, faces: np.ndarray, weights: scipy.sparse.csr_matrix
) -> tuple[np.ndarray, np.ndarray, scipy.sparse.csr_matrix, np.ndarray]:
    """The surface with vertices that lie on each other as one, without triangles that thus have no area, and which of
    the ``faces`` are left."""
    step = WELD_SHARE * max(float(np.ptp(vertices, axis=0).max()), 1e-12)
    _, first, index = np.unique(np.rint(vertices / step), axis=0, return_index=True, return_inverse=True)
    joined = index.reshape(-1)[faces]
    whole = (joined[:, 0] != joined[:, 1]) & (joined[:, 1] != joined[:, 2]) & (joined[:, 2] != joined[:, 0])
    return vertices[first], joined[whole], scipy.sparse.csr_matrix(weights[first]), np.flatnonzero(whole)
