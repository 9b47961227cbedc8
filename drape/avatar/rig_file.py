"""Draped garments as a GLB on the character's own rig: its nodes as they came, garments skinned to them, and morphs.

A vertex v moves by the blend A = sum_j w_j W_j B_j of its joints' world transforms W and inverse bind matrices B. A
vertex that was draped at x therefore gets the morph target A^-1 x - v in its frame: morphed and skinned it lies at x,
whatever the weights. So the weights may be plain ones, of four joints near the vertex. Without its targets the garment
is the one at rest, and follows any animation of the rig as skinned garments do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse

from drape.avatar.covered import DEEPER_M
from drape.avatar.file_skeleton import FileRig, FileSkeleton
from drape.avatar.own_clothes import bare_colours
from drape.avatar.own_garments import Undressed
from drape.avatar.rig_motion import RigClip, rig_motion
from drape.avatar.rig_weights import garment_weights, heaviest, joint_blends, volume
from drape.avatar.wearer import Wearer
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from drape.export.glb import NORMAL_STEPS, Corners, Shape, add_shape, normal_steps, split_seams, vertex_normals
from drape.export.glb_file import VERTEX_BUFFER, GlbFile
from drape.export.surface import MeshSurface
from drape.garment.cache import Garment
from drape.motion.joint_names import ancestors
from drape.wanted import go_on

BARE, UNDER, TUCKED = "bare skin", "skin under garments", "tucked top"
DEEPER = {"extras": {"deeper_m": DEEPER_M}}  # Fields of a node.
GAMMA = 2.2  # glTF's colours are linear, and ours are sRGB.
_NO_MATERIALS = np.zeros((0, 3), dtype=np.int64), (), np.zeros(0, dtype=np.int64)
# A blend of joints that keeps a smaller share of their volume cannot be inverted: such a vertex gets one joint.
LEAST_VOLUME = 0.2


@dataclass(frozen=True, eq=False)
class Dressed:
    """A ``garment`` on a character over a clip: the vertices [m] (F, D, 3) that are drawn, in the world of the rig, and
    its ``colour``, linear red, green, blue and opacity."""

    garment: Garment
    vertices: np.ndarray
    colour: tuple[float, float, float, float]


def add_dressed(
    file: GlbFile,
    nodes: dict[int, int],
    layers: Sequence[Dressed],
    clip: RigClip,
    wearer: Wearer,
    rig: FileRig,
    *,
    quantised: bool = True,
) -> None:
    """Adds the garments ``layers`` to ``file``, skinned to the rig and with a morph target for each frame, and an
    animation of ``clip``. Lengths are in the unit of the character's own file.

    ``wearer`` wears the ``layers``, and ``rig`` is that of its file. The skeleton's node n is the node ``nodes[n]`` of
    ``file``. ``quantised``: normals have 8 bits (KHR_mesh_quantization), otherwise they are float32.
    """
    skeleton = rig.skeleton
    motion = rig_motion(clip, wearer, skeleton)
    blends = motion.blends
    skin = _add_skin(file, skeleton, nodes)
    for layer in layers:
        weights = garment_weights(layer.garment, wearer, rig)
        at, surface = np.concatenate([layer.garment.drawn_at_rest()[None], layer.vertices]), layer.garment.surface
        corners = split_seams(surface)
        shape = _shape(file, corners, surface.faces, at / wearer.scale, weights, blends, quantised=quantised)
        whole = Shape(shape, {"skin": skin})
        add_shape(file, surface, corners, whole, len(layer.vertices), clip.fps, layer.colour)
    motion.animate(file, nodes)


def bare_file(wearer: Wearer, rig: FileRig, left: Undressed) -> GlbFile:
    """Returns a new file with the nodes of ``rig`` and what ``add_bare`` adds to them."""
    file = GlbFile()
    add_bare(file, add_nodes(file, rig.skeleton), wearer, rig, left)
    return file


def add_bare(file: GlbFile, nodes: dict[int, int], wearer: Wearer, rig: FileRig, left: Undressed) -> None:
    """Adds to ``file`` the meshes that are seen where clothes of ``wearer`` are not drawn, which ``left`` says. These
    are skin in its mean colour (at the hips in that of trousers that stay on), and a tucked top in the colours of its
    faces.

    All are skinned to the nodes of ``rig`` in the unit of the character's file; the skeleton's node n is ``nodes[n]``.
    The nodes of the top, and of skin under garments, have ``deeper_m`` [m]: clients draw them so much farther from the
    viewer, and cloth hides them.
    """
    body, top, attire = wearer.body, left.tucked, wearer.attire
    still = RigClip(*wearer.to_rig(np.zeros((1, JOINT_COUNT, 3)), np.zeros((1, 3))), 1.0)
    blends = rig_motion(still, wearer, rig.skeleton).part(np.zeros(0, dtype=np.int64)).blends
    onto, skin = _onto_joints(wearer, rig.skeleton), _add_skin(file, rig.skeleton, nodes)

    def add(mesh: tuple[str, np.ndarray, np.ndarray, np.ndarray], colours: np.ndarray, fields: dict[str, Any]) -> None:
        name, vertices, faces, weights = mesh
        surface = MeshSurface(name, len(vertices), faces, np.zeros((0, 2)), *_NO_MATERIALS)
        corners, on = split_seams(surface), scipy.sparse.csr_matrix(weights) @ onto
        parts = _shape(file, corners, faces, vertices[None] / wearer.scale, on, blends, quantised=False)
        plain = bool((colours == colours[0]).all())
        shade = colours[0] if plain else np.ones(3)
        if not plain:
            parts[0]["COLOR_0"] = file.array(
                (colours[corners.source] ** GAMMA).astype(np.float32), target=VERTEX_BUFFER
            )
        red, green, blue = (shade**GAMMA).tolist()
        add_shape(file, surface, corners, Shape(parts, {"skin": skin} | fields), 0, 1.0, (red, green, blue, 1.0))

    colours = bare_colours(body, attire, wearer.vertices, wearer.faces, left.off)
    deep = np.zeros_like(left.bare) if left.deep is None else left.bare & left.deep
    for name, there, fields in ((BARE, left.bare & ~deep, {}), (UNDER, deep, DEEPER)):
        if there.any():
            used, faces = np.unique(body.faces[there], return_inverse=True)
            add((name, body.v_template[used], faces.reshape(-1, 3), body.weights[used]), colours[used], fields)
    if top is not None:
        own, count = np.repeat(attire.colours[top.rows], 3, axis=0), np.bincount(top.faces.reshape(-1))
        sums = [np.bincount(top.faces.reshape(-1), channel) for channel in own.T]
        colours = np.stack(sums, axis=1) / count[:, None]
        add((TUCKED, top.vertices, top.faces, top.weights), colours, DEEPER)


def _onto_joints(wearer: Wearer, skeleton: FileSkeleton) -> scipy.sparse.csr_matrix:
    """The joint (24, J) of the file that moves what each joint of ours does: its node, or the nearest joint above."""
    column = {int(node): number for number, node in enumerate(skeleton.joints)}
    columns: list[int] = []
    for joint, name in enumerate(JOINT_NAMES):
        line = ancestors(skeleton.parents, wearer.rig.sources.get(name, -1))
        otherwise = columns[PARENTS[joint]] if joint else 0
        columns.append(next((column[node] for node in line if node in column), otherwise))
    onto = np.ones(len(columns)), (np.arange(len(columns)), np.array(columns))
    return scipy.sparse.csr_matrix(onto, (len(columns), len(skeleton.joints)))


def add_nodes(file: GlbFile, skeleton: FileSkeleton) -> dict[int, int]:
    """Adds the nodes of ``skeleton`` to ``file``, its ``tops`` at the top of the scene. Returns the index of each new
    node by the index of the skeleton's node. Nodes that carry no joint are left out."""
    kept, waiting = [], list(skeleton.tops[::-1])
    while waiting:
        kept.append(waiting.pop())
        waiting.extend(reversed(skeleton.children[kept[-1]]))
    first = len(file.json["nodes"])
    nodes = {node: first + number for number, node in enumerate(kept)}
    for node in kept:
        written: dict[str, Any] = dict(skeleton.written[node])
        if skeleton.children[node]:
            written["children"] = [nodes[child] for child in skeleton.children[node]]
        file.add("nodes", written)
    file.json["scenes"][0]["nodes"] += [nodes[top] for top in skeleton.tops]
    return nodes


def _add_skin(file: GlbFile, skeleton: FileSkeleton, nodes: dict[int, int]) -> int:
    """The skin in ``file``."""
    columns = np.swapaxes(skeleton.binds, -1, -2).astype(np.float32)  # glTF stores matrices column by column.
    columns[:, :, 3] = [0.0, 0.0, 0.0, 1.0]
    joints = [nodes[int(joint)] for joint in skeleton.joints]
    return file.add("skins", {"joints": joints, "inverseBindMatrices": file.array(columns)})


def _shape(
    file: GlbFile,
    corners: Corners,
    faces: np.ndarray,
    at: np.ndarray,
    weights: scipy.sparse.csr_matrix,
    blends: np.ndarray,
    *,
    quantised: bool,
) -> list[dict[str, int]]:
    """Accessors of the mesh that is at ``at[0]`` in the first of ``blends`` (F + 1, J, 4, 4), and of the ways to what
    is at ``at`` (F + 1, V, 3) in the others."""
    flat = blends[:, :, :3, :].reshape(len(blends), -1, 12)
    bones, kept = heaviest(weights, np.zeros(len(at[0]), dtype=bool))
    volumes = [volume(joint_blends(kept, bones, maps)) / volume(maps.reshape(-1, 3, 4))[bones[:, 0]] for maps in flat]
    bones, kept = heaviest(weights, np.min(volumes, axis=0) < LEAST_VOLUME)
    parts: list[dict[str, int]] = []
    first, first_normals = np.zeros(0), None
    for points, maps in zip(at, flat, strict=True):
        go_on()
        blends_now = joint_blends(kept, bones, maps)
        inverse = np.linalg.inv(blends_now[:, :, :3])
        bound = np.einsum("vab,vb->va", inverse, points - blends_now[:, :, 3])
        normals = np.einsum("vab,vb->va", inverse, vertex_normals(points[None], faces)[0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        way = bound - first if parts else bound
        if quantised:
            steps = normal_steps(normals, first_normals).astype(np.int8)
            (turned,) = file.quantised_rows(steps[corners.source][None])
            rounded = steps / NORMAL_STEPS
        else:
            rounded = (normals if first_normals is None else normals - first_normals).astype(np.float32)
            turned = file.array(rounded[corners.source], target=VERTEX_BUFFER)
        placed = way.astype(np.float32)
        if not parts:
            first, first_normals = placed.astype(np.float64), rounded.astype(np.float64)
        position = file.array(placed[corners.source], target=VERTEX_BUFFER, bounds=True)
        parts.append({"POSITION": position, "NORMAL": turned})
    if quantised:
        file.quantised()
    joint = np.uint8 if len(flat[0]) <= 256 else np.uint16
    parts[0]["JOINTS_0"] = file.array(bones[corners.source].astype(joint), target=VERTEX_BUFFER)
    parts[0]["WEIGHTS_0"] = file.array(kept[corners.source], target=VERTEX_BUFFER)
    return parts
