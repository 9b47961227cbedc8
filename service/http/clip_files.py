"""Clips as files: GLB with a garment's frames or a skinned body, PC2, USD and vertex animation textures."""

from __future__ import annotations

import io
import itertools
import zipfile
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from drape.avatar.covered import UNSEEN_M, covered_faces
from drape.avatar.distilled import DrapedClip, distil
from drape.avatar.file_skeleton import load_file_rig
from drape.avatar.joint_file import Jointed, add_clip
from drape.avatar.rig_file import Dressed, add_bare, add_dressed, add_nodes
from drape.avatar.rig_motion import RigClip, rig_motion
from drape.body.model import BodyModel
from drape.export import glb
from drape.export.glb_body import add_body
from drape.export.glb_file import GlbFile
from drape.export.pc2 import pc2_head
from drape.export.root_motion import RootMotion
from drape.export.surface import MovingGarment, by_layer
from drape.export.usd_stage import check_usd, usd_file
from drape.export.vat import check_vat, vat_files
from drape.garment.cache import Garment
from service.http.answers import USDZ, VAT, number_bytes

if TYPE_CHECKING:
    from pathlib import Path

    from drape.avatar.own_garments import Undressed
    from drape.avatar.wearer import Wearer
    from drape.stages.batch import PoseInput
    from drape.stages.placing import Placed
    from drape.stages.scene import Scene
    from service.http.schemas import ClipOptions, PosedOptions


def rest_file(garment: Garment) -> tuple[GlbFile, bytes]:
    """Returns a GLB of ``garment`` at rest, and the bytes that it begins with."""
    file = GlbFile()
    glb.add_garment(file, garment.surface, garment.drawn_at_rest()[None], fps=1.0)
    return file, file.head()


def garment_file(
    scene: Scene, placed: Placed, asked: ClipOptions, clip: PoseInput, model: BodyModel
) -> tuple[GlbFile, bytes]:
    """Returns a GLB of the garments of ``scene`` over ``clip``, where they are ``placed``, and the bytes that it begins
    with. If it is ``asked``, the body ``model`` is in it too."""
    file, start = GlbFile(), 0
    vertices, point = placed.from_first()
    root_motion = None
    if asked.quantised:
        root_motion = RootMotion(clip.poses[:, 0], clip.trans + model.rest_joints(clip.betas)[0] - point)
    for layer, worn in enumerate(scene.layers):
        colour = glb.GARMENT_COLOURS[layer % len(glb.GARMENT_COLOURS)]
        own = vertices[:, start : start + worn.vertex_count]
        glb.add_garment(file, worn.garment.surface, own, asked.fps, colour, root_motion=root_motion)
        start += worn.vertex_count
    if asked.body:
        add_body(file, model, clip.betas, clip.poses, clip.trans - point, asked.fps)
    if asked.origin == "root":
        file.place("root", point)
    return file, file.head()


def dress_scene(scene: Scene, placed: Placed) -> list[Dressed]:
    """The garments of ``scene`` where they are ``placed``, each in its colour."""
    return [
        Dressed(worn.garment, own, glb.GARMENT_COLOURS[i % len(glb.GARMENT_COLOURS)])
        for i, (worn, own) in enumerate(zip(scene.layers, by_layer(scene.layers, placed.vertices), strict=True))
    ]


def on_rig_file(
    layers: list[Dressed],
    wearer: Wearer,
    stored: Path,
    clip: PoseInput,
    turns: np.ndarray | None,
    left: Undressed,
    *,
    fps: float,
    quantised: bool,
    joints: int | None,
) -> tuple[GlbFile, bytes]:
    """Returns a GLB of the garments ``layers`` on the rig of ``wearer``, whose file is ``stored``, over ``clip``, and
    the bytes that it begins with.

    ``turns`` (F, N, 4) are the quaternions of the rig's nodes, if the client sent these. The garments have ``joints``
    joints of their own each, or morph targets if that is None. What ``left`` says is seen of the character is in it
    too.
    """
    quaternions, places = wearer.to_rig(clip.poses, clip.trans)
    # Nodes that no joint of ours moves turn as they were told.
    moves = RigClip(quaternions if turns is None else turns, places, fps)
    rig, file = load_file_rig(stored), GlbFile()
    nodes = add_nodes(file, rig.skeleton)
    if joints is None:
        add_dressed(file, nodes, layers, moves, wearer, rig, quantised=quantised)
    else:
        motion, jointed = rig_motion(moves, wearer, rig.skeleton), []
        for layer in layers:
            draped = DrapedClip(layer.vertices, motion)
            distilled = distil(layer.garment, [draped], wearer, rig, count=joints)
            jointed.append(Jointed(layer.garment.surface, distilled, layer.colour))
        add_clip(file, jointed, [layer.vertices for layer in layers], motion, nodes, wearer.scale)
    if left.added:
        body, cloth = wearer.body, [(one.garment.vertices, one.garment.faces) for one in layers]
        unseen = covered_faces(body.v_template, body.faces, cloth, margin_m=UNSEEN_M)
        add_bare(file, nodes, wearer, rig, left._replace(bare=left.bare & ~unseen, deep=None))
    return file, file.head()


def body_file(body: BodyModel, clip: PoseInput, asked: PosedOptions) -> tuple[GlbFile, bytes]:
    """Returns a GLB of the posed ``body`` over ``clip``, and the bytes that it begins with."""
    file = GlbFile()
    point = clip.trans[0] + body.rest_joints(clip.betas)[0] if asked.origin == "root" else np.zeros(3)
    add_body(file, body, clip.betas, clip.poses, clip.trans - point, asked.fps)
    if asked.origin == "root":
        file.place("root", point)
    return file, file.head()


def move_garments(scene: Scene, placed: Placed) -> tuple[list[MovingGarment], np.ndarray]:
    """Returns the garments of ``scene`` where they are ``placed``, and the point [m] (3,) in the world that they count
    from: the first frame's root, or the origin."""
    vertices, point = placed.from_first()
    layers = [
        MovingGarment(entry.garment.surface, own, glb.GARMENT_COLOURS[i % len(glb.GARMENT_COLOURS)])
        for i, (entry, own) in enumerate(zip(scene.layers, by_layer(scene.layers, vertices), strict=True))
    ]
    return layers, point


def point_cache(placed: Placed) -> Iterator[bytes]:
    """Yields ``placed`` as a PC2 file, in pieces."""
    vertices, _ = placed.from_first()
    return itertools.chain([pc2_head(vertices.shape[1], len(vertices))], number_bytes(vertices))


def check_package(kind: str) -> None:
    """Refuses (``Unavailable``) a file of ``kind`` for which a package is missing."""
    if kind == USDZ:
        check_usd()
    if kind == VAT:
        check_vat()


def pack_scene(layers: list[MovingGarment], point: np.ndarray, fps: float, kind: str) -> bytes:
    """Returns ``layers``, which count from ``point`` [m] (3,), as one file of ``kind``: a USDZ, or a ZIP with the files
    of a vertex animation texture."""
    if kind == USDZ:
        return usd_file(layers, fps, ".usdz", point=point)
    out, names = io.BytesIO(), "_".join(layer.surface.name for layer in layers)
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in vat_files(layers, fps, names).items():
            archive.writestr(name, content)
    return out.getvalue()
