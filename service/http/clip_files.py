"""Writes clips as files: GLB with a garment's frames or a skinned body, PC2, USD and vertex animation textures.

A function that returns a ``GlbFile`` also returns its head: the bytes of the file before its binary data.
"""

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
    """Returns a GLB of what is drawn of ``garment``, at rest, and the bytes of its head (``GlbFile.head``)."""
    file = GlbFile()
    glb.add_garment(file, garment.surface, garment.drawn_at_rest()[None], fps=1.0)
    return file, file.head()


def garment_file(
    scene: Scene, placed: Placed, request: ClipOptions, clip: PoseInput, model: BodyModel
) -> tuple[GlbFile, bytes]:
    """Returns a GLB of the garments of ``scene`` in the frames of ``clip``, and the bytes of its head
    (``GlbFile.head``). ``placed`` has the garments' vertices, one garment after the other. ``request`` says whether the
    body ``model`` is in the file too, and whether positions are quantised."""
    file, start = GlbFile(), 0
    vertices, point = placed.from_first()
    root_motion = None
    if request.quantised:
        root_motion = RootMotion(clip.poses[:, 0], clip.trans + model.rest_joints(clip.betas)[0] - point)
    for layer, worn in enumerate(scene.layers):
        colour = glb.GARMENT_COLOURS[layer % len(glb.GARMENT_COLOURS)]
        own = vertices[:, start : start + worn.vertex_count]
        glb.add_garment(file, worn.garment.surface, own, request.fps, colour, root_motion=root_motion)
        start += worn.vertex_count
    if request.body:
        add_body(file, model, clip.betas, clip.poses, clip.trans - point, request.fps)
    if request.origin == "root":
        file.place("root", point)
    return file, file.head()


def dress_scene(scene: Scene, placed: Placed) -> list[Dressed]:
    """Returns each garment of ``scene`` with its vertices of ``placed`` and its colour."""
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
    """Returns a GLB of the garments ``layers`` on the rig of ``wearer`` in the frames of ``clip``, and the bytes of its
    head (``GlbFile.head``). ``stored`` is the wearer's file.

    ``turns`` (F, N, 4) are the rig's own quaternions (xyzw) of its N nodes, None unless the client sent these. Each
    garment has ``joints`` joints of its own, or morph targets if that is None. Skin that ``left`` adds, where clothes
    are taken off, is in the file too.
    """
    quaternions, places = wearer.to_rig(clip.poses, clip.trans)
    # With turns of a client those nodes move too that none of the 24 joints moves.
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
        body, cloth = wearer.body, [(layer.garment.vertices, layer.garment.faces) for layer in layers]
        unseen = covered_faces(body.v_template, body.faces, cloth, margin_m=UNSEEN_M)
        add_bare(file, nodes, wearer, rig, left._replace(bare=left.bare & ~unseen, deep=None))
    return file, file.head()


def body_file(body: BodyModel, clip: PoseInput, request: PosedOptions) -> tuple[GlbFile, bytes]:
    """Returns a GLB of ``body`` as a skinned mesh in the frames of ``clip``, and the bytes of its head
    (``GlbFile.head``)."""
    file = GlbFile()
    point = clip.trans[0] + body.rest_joints(clip.betas)[0] if request.origin == "root" else np.zeros(3)
    add_body(file, body, clip.betas, clip.poses, clip.trans - point, request.fps)
    if request.origin == "root":
        file.place("root", point)
    return file, file.head()


def move_garments(scene: Scene, placed: Placed) -> tuple[list[MovingGarment], np.ndarray]:
    """Returns each garment of ``scene`` with its vertices of ``placed`` and its colour, and the point [m] (3,) of the
    world that vertices are relative to: the root joint in the first frame, or the origin."""
    vertices, point = placed.from_first()
    layers = [
        MovingGarment(entry.garment.surface, own, glb.GARMENT_COLOURS[i % len(glb.GARMENT_COLOURS)])
        for i, (entry, own) in enumerate(zip(scene.layers, by_layer(scene.layers, vertices), strict=True))
    ]
    return layers, point


def point_cache(placed: Placed) -> Iterator[bytes]:
    """Returns an iterator over the bytes of a PC2 file with the vertices of ``placed``, in pieces."""
    vertices, _ = placed.from_first()
    return itertools.chain([pc2_head(vertices.shape[1], len(vertices))], number_bytes(vertices))


def check_package(kind: str) -> None:
    """Refuses (``Unavailable``) a file of the media type ``kind`` if the package that writes it is missing."""
    if kind == USDZ:
        check_usd()
    if kind == VAT:
        check_vat()


def pack_scene(layers: list[MovingGarment], point: np.ndarray, fps: float, kind: str) -> bytes:
    """Returns the bytes of a file with ``layers``, whose vertices are relative to ``point`` [m] (3,), at ``fps`` frames
    per second: a USDZ, or else a ZIP with the files of a vertex animation texture, as the media type ``kind`` says."""
    if kind == USDZ:
        return usd_file(layers, fps, ".usdz", point=point)
    out, names = io.BytesIO(), "_".join(layer.surface.name for layer in layers)
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in vat_files(layers, fps, names).items():
            archive.writestr(name, content)
    return out.getvalue()
