"""A user's character as its file has it: nodes at rest, skinned surface, which nodes VRM calls which bones.

Everything is in the file's own units and axes, in the pose of its nodes. That pose may differ from the one in which
the surface was bound to the skeleton; the surface is where the skin puts it, so vertices are skinned once here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse

from drape.errors import MeshError
from drape.files.gltf import GltfFile
from drape.files.gltf_json import EXPORT, Node
from drape.files.gltf_json import Primitive as FilePrimitive
from drape.files.gltf_nodes import node_matrix, tree_of, world_matrices

MOST_JOINTS = 400
MOST_UNITS = 1e12  # Nodes and vertices may be so far out in any unit of length.
MOST_VERTICES = 400_000
LEAST_VERTICES = 100
# Vertices nearer to each other, as a share of the height, are one that was split for texture coordinates.
WELD_SHARE = 1e-5
TRIANGLES = 4


class Primitive(NamedTuple):
    """One primitive of a glTF mesh: the index ``node`` and the ``name`` of its node in the file, its index
    ``primitive`` in the mesh, and its number of ``triangles``."""

    node: int
    name: str
    primitive: int
    triangles: int


@dataclass(frozen=True, eq=False)
class Character:
    """Nodes and surface of a character, in the unit and the axes of its file.

    There are N nodes, parents before children, with ``names`` and ``parents`` (-1: none). ``world`` (N, 4, 4) are their
    world transforms at rest.

    The surface has ``vertices`` (V, 3) at rest, ``faces`` (F, 3) and sparse ``weights`` (V, N), whose rows sum to one.
    ``primitives`` have the file's triangles one after the other, and ``triangle`` (F,) is the index of each face among
    these triangles. ``hung`` (F,) bool marks faces of meshes without a skin that hang on a bone, as swords and hats do.
    A mesh whose node is no bone moves with the nearest bone above.

    ``vrm`` is the version "0" or "1" of a VRM, otherwise "". ``humanoid`` has VRM's bones and the indices of their
    nodes; it is empty where the file is not a VRM.
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
    hung: np.ndarray | None = None

    def only(self, chosen: np.ndarray) -> Character:
        """Returns the character with the faces ``chosen`` (F,) bool alone, and the vertices that they use. Its
        ``triangle`` and ``hung`` are None."""
        used, faces = np.unique(self.faces[chosen], return_inverse=True)
        rows = {"vertices": self.vertices[used], "weights": scipy.sparse.csr_matrix(self.weights[used])}
        return replace(self, faces=faces.reshape(-1, 3), triangle=None, hung=None, **rows)

    @property
    def skinned(self) -> Character:
        """The character without the faces that hang on its bones."""
        return self if self.hung is None or not self.hung.any() else self.only(~self.hung)

    @property
    def places(self) -> np.ndarray:
        """The positions (N, 3) of the nodes at rest, in the unit and the axes of the file."""
        return self.world[:, :3, 3]


def character_in(file: GltfFile) -> Character:
    """Returns the character in ``file``. Raises ``MeshError`` where no surface has a skin, or where the surface or the
    skeleton is damaged or too large."""
    nodes, label = file.document.nodes, file.label
    order, parents = tree_of(file)
    place = {node: number for number, node in enumerate(order)}
    world = world_matrices(np.array([node_matrix(nodes[node]) for node in order]).reshape(-1, 4, 4), parents)
    _check_places(world, f"{label}: nodes", order)
    parts, skinned = _surface(file, place, world)
    vertices, faces, weights = _joined(list(parts.values()))
    _check_joints(weights, label)
    if not np.abs(vertices).max() < MOST_UNITS:
        expected = f"vertices within {MOST_UNITS:.0e} units"
        raise MeshError(f"{label}: skin", expected=expected, got="others", cure=EXPORT)
    humanoid, version = _vrm_bones(file, place)
    names = tuple(_name(nodes[node]) for node in order)
    vertices, faces, weights, triangle = _welded(vertices, faces, weights)
    return Character(
        names, parents, world, vertices, faces, weights, humanoid, version, tuple(parts), triangle, triangle >= skinned
    )  # fmt: skip


def _name(node: Node) -> str:
    return (node.name or "")[:120]


def _check_places(moves: np.ndarray, name: str, numbers: Sequence[int]) -> None:
    """Refuses transforms (N, 4, 4), called ``name`` and their ``numbers``, that lead too far or cannot be undone."""
    fits = (np.abs(moves).max(axis=(1, 2), initial=0.0) < MOST_UNITS) & (np.abs(np.linalg.det(moves)) > 1e-30)
    if not fits.all():
        cure = "Apply the transforms of the armature and export again."
        got = f"that of {numbers[int(fits.argmin())]}"
        raise MeshError(name, expected="transforms that can be undone", got=got, cure=cure)


Part = tuple[np.ndarray, np.ndarray, scipy.sparse.csr_matrix]
Listed = list[tuple[int, int, FilePrimitive]]


def _surface(file: GltfFile, place: dict[int, int], world: np.ndarray) -> tuple[dict[Primitive, Part], int]:
    """Vertices, faces and weights over nodes of each primitive of triangles that moves with a skeleton, those of
    skinned meshes first, and how many of the faces these have."""
    nodes = file.document.nodes
    skinned = listed_primitives(
        file, [node for node in place if nodes[node].skin is not None], {"JOINTS_0", "WEIGHTS_0"}
    )
    if not skinned:
        raise MeshError(
            f"{file.label}: skin",
            expected="a surface that a skeleton moves",
            got="no mesh with a skin",
            cure="Export the character with its armature and its skin weights.",
        )
    _check_size(file, [primitive for _, _, primitive in skinned])
    skins: dict[int | None, tuple[np.ndarray, np.ndarray]] = {}
    parts: dict[Primitive, Part] = {}
    for node, index, primitive in skinned:
        skin = nodes[node].skin
        if skin not in skins:
            joints, binds = skin_of(file, skin)
            rows = np.array([place[joint] for joint in joints])
            skins[skin] = rows, world[rows] @ binds
        part = _primitive(file, primitive, *skins[skin], len(world))
        parts[Primitive(node, _name(nodes[node]), index, len(part[1]))] = part
    count = sum(one.triangles for one in parts)
    above = _bones_above(file, {int(row) for rows, _ in skins.values() for row in rows}, place)
    hung = listed_primitives(file, list(above), set())
    _check_size(file, [primitive for _, _, primitive in (*skinned, *hung)])
    for node, index, primitive in hung:
        part = _on_bone(file, primitive, world[place[node]], above[node], len(world))
        parts[Primitive(node, _name(nodes[node]), index, len(part[1]))] = part
    return parts, count


def listed_primitives(file: GltfFile, nodes: list[int], attributes: set[str]) -> Listed:
    """Returns the primitives of triangles in the meshes of ``nodes`` that have positions and all of ``attributes``: of
    each the index of its node in the file, its index in the mesh, and the primitive."""
    wanted = attributes | {"POSITION"}
    return [
        (node, index, primitive)
        for node in nodes
        for index, primitive in enumerate(
            file.item("meshes", file.document.nodes[node].mesh, f"nodes[{node}].mesh").primitives
        )
        if primitive.mode == TRIANGLES and wanted <= primitive.attributes.keys()
    ]


def _bones_above(file: GltfFile, joints: set[int], place: dict[int, int]) -> dict[int, int]:
    """Nodes with a mesh and no skin below a joint -> the place of the nearest joint above, among ``joints``."""
    bones: dict[int, int] = {}
    carried: dict[int, int] = {}
    for node, number in place.items():  # Parents come first.
        if number in joints:
            carried[node] = number
        held = file.document.nodes[node]
        if node in carried:
            carried |= {child: carried[node] for child in held.children}
            if held.mesh is not None and held.skin is None:
                bones[node] = carried[node]
    return bones


def _on_bone(file: GltfFile, primitive: FilePrimitive, world: np.ndarray, joint: int, nodes: int) -> Part:
    """One primitive without a skin whose node has the transform ``world`` (4, 4) and moves with ``joint``."""
    points, faces = triangles_of(file, primitive)
    placed = points @ world[:3, :3].T + world[:3, 3]
    rows = np.arange(len(points)), np.full(len(points), joint)
    return placed, faces, scipy.sparse.csr_matrix((np.ones(len(points)), rows), (len(points), nodes))


def skin_of(file: GltfFile, index: Any) -> tuple[list[int], np.ndarray]:
    """Returns the joints of skin ``index`` of ``file``, J indices of nodes in the file's order, and their inverse bind
    matrices (J, 4, 4). Raises ``MeshError`` for an index, joints or matrices that do not fit."""
    skin = file.item("skins", index, "nodes.skin")
    if not 0 < len(skin.joints) <= MOST_JOINTS:
        cure = "Export the deforming bones alone."
        name, expected = f"{file.label}: skins[{index}].joints", f"1 to {MOST_JOINTS} joints"
        raise MeshError(name, expected=expected, got=str(len(skin.joints)), cure=cure)
    for joint in skin.joints:
        file.item("nodes", joint, f"skins[{index}].joints")
    if skin.inverse_bind_matrices is None:
        return skin.joints, np.tile(np.eye(4), (len(skin.joints), 1, 1))
    flat, count = file.array(skin.inverse_bind_matrices), len(skin.joints)
    if flat.shape != (count, 16):
        name, expected = f"{file.label}: inverseBindMatrices", f"({count}, 16)"
        raise MeshError(name, expected=expected, got=f"shape {flat.shape}", cure=EXPORT)
    binds = flat.astype(np.float64).reshape(-1, 4, 4).transpose(0, 2, 1).copy()
    binds[:, 3] = [0.0, 0.0, 0.0, 1.0]
    _check_places(binds, f"{file.label}: skins[{index}].inverseBindMatrices", range(count))
    return skin.joints, binds


def _primitive(file: GltfFile, primitive: FilePrimitive, rows: np.ndarray, moves: np.ndarray, nodes: int) -> Part:
    """One primitive, its vertices where ``moves`` (J, 4, 4) of the joints put them."""
    points, faces = triangles_of(file, primitive)
    over_joints = skin_weights(file, primitive, len(points), len(rows))
    blended = (over_joints @ moves.reshape(len(rows), 16)).reshape(len(points), 4, 4)
    placed = np.einsum("vab,vb->va", blended[:, :3, :3], points) + blended[:, :3, 3]
    onto = scipy.sparse.csr_matrix((np.ones(len(rows)), (np.arange(len(rows)), rows)), (len(rows), nodes))
    return placed, faces, scipy.sparse.csr_matrix(over_joints @ onto)


def skin_weights(file: GltfFile, primitive: FilePrimitive, count: int, joints: int) -> scipy.sparse.csr_matrix:
    """Returns the skinning weights (V, J), sparse, of a ``primitive`` with V = ``count`` vertices on the J = ``joints``
    joints of its skin. They are not negative, and rows sum to one. Raises ``MeshError`` for arrays of the file that do
    not fit."""
    held = primitive.attributes
    sets = [k for k in range(4) if f"JOINTS_{k}" in held and f"WEIGHTS_{k}" in held]
    read = [file.array(held[f"{kind}_{k}"]) for kind in ("JOINTS", "WEIGHTS") for k in sets]
    fits = all(one.shape == (count, 4) for one in read)
    joint, weight = np.split(np.concatenate(read, axis=1), 2, axis=1) if fits else np.zeros((2, 1, 1))
    weight = np.maximum(weight.astype(np.float64), 0.0)
    joint = np.where(weight > 0.0, joint, 0).astype(np.int64)
    if not (fits and joint.min() >= 0 and joint.max() < joints):
        raise _no_fit(file)
    total = weight.sum(axis=1, keepdims=True)
    weight = np.where(total > 1e-6, weight / np.maximum(total, 1e-12), np.eye(1, weight.shape[1]))
    spread = np.repeat(np.arange(count), joint.shape[1])
    return scipy.sparse.csr_matrix((weight.reshape(-1), (spread, joint.reshape(-1))), (count, joints))


def triangles_of(file: GltfFile, primitive: FilePrimitive) -> tuple[np.ndarray, np.ndarray]:
    """Returns the positions (V, 3) of a ``primitive``, in the unit of the file and the frame of its mesh, and its faces
    (F, 3). Raises ``MeshError`` for arrays of the file that do not fit."""
    points = file.array(primitive.attributes.get("POSITION")).astype(np.float64)
    faces = np.arange(len(points))[:, None] if primitive.indices is None else file.array(primitive.indices)
    faces = faces[: len(faces) - len(faces) % 3].astype(np.int64).reshape(-1, 3)
    if points.shape[1] != 3 or not (faces.min(initial=0) >= 0 and faces.max(initial=0) < len(points)):
        raise _no_fit(file)
    return points, faces


def _no_fit(file: GltfFile) -> MeshError:
    expected = "positions, joints and weights that fit together"
    return MeshError(f"{file.label}: mesh", expected=expected, got="others", cure=EXPORT)


def _joined(parts: list[Part]) -> Part:
    """``parts`` as one surface."""
    start = np.cumsum([0, *(len(points) for points, _, _ in parts)])
    faces = [faces + first for (_, faces, _), first in zip(parts, start, strict=False)]
    weights = scipy.sparse.csr_matrix(scipy.sparse.vstack([weights for _, _, weights in parts]))
    return np.concatenate([points for points, _, _ in parts]), np.concatenate(faces), weights


def _check_size(file: GltfFile, primitives: list[FilePrimitive]) -> None:
    """Refuses a surface by what its accessors say, before any is read."""
    vertices = [file.count(one.attributes.get("POSITION")) for one in primitives]
    corners = [at if one.indices is None else file.count(one.indices)
               for one, at in zip(primitives, vertices, strict=True)]  # fmt: skip
    count, triangles = sum(vertices), sum(corners) // 3
    if not (LEAST_VERTICES <= count <= MOST_VERTICES and LEAST_VERTICES <= triangles <= 3 * MOST_VERTICES):
        got = f"{count:,} vertices and {triangles:,} triangles"
        wanted = f"{LEAST_VERTICES} to {MOST_VERTICES:,} vertices in triangles"
        raise MeshError(f"{file.label}: mesh", expected=wanted, got=got, cure="Export a whole character, decimated.")


def _check_joints(weights: scipy.sparse.csr_matrix, label: str) -> None:
    used = int((np.diff(weights.tocsc().indptr) > 0).sum())
    if used > MOST_JOINTS:
        cure = "Export the deforming bones alone."
        raise MeshError(f"{label}: skin", expected=f"at most {MOST_JOINTS} joints", got=str(used), cure=cure)


def _vrm_bones(file: GltfFile, place: dict[int, int]) -> tuple[dict[str, int], str]:
    """VRM's bones -> places of nodes, and the version of VRM."""
    extensions = file.document.extensions
    version = "1" if extensions.vrmc_vrm is not None else "0" if extensions.vrm is not None else ""
    try:
        return {bone[:60]: place[node] for bone, node in extensions.humanoid.items() if version}, version
    except KeyError as error:
        cure = "Export the VRM again, or send it as a plain GLB."
        expected = "bones at nodes of the file"
        raise MeshError(f"{file.label}: humanBones", expected=expected, got=f"node {error}", cure=cure) from error


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
