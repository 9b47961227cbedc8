"""A delivered mesh as it rests on the standard body: checked, moved to T-pose, subdivided, pushed clear of the body."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.files.notes import warning
from drape.garment.accessories import bones_that_carry, carried_rows
from drape.garment.avatars import Avatar
from drape.garment.bound import BoundMesh
from drape.garment.cache import Garment
from drape.garment.clearance import CLEARANCE_M, Cleared, clear_body
from drape.garment.cloth_layer import cloth_layer, hung
from drape.garment.files.mesh import GarmentMesh
from drape.garment.mantle_rest import spread
from drape.garment.mesh_checks import check_mesh
from drape.garment.rest_detail import subdivided_like
from drape.garment.rest_pose import MovedGarment, bone_motions, refine, to_standard
from drape.garment.seats import Seat
from drape.garment.sheets import with_used_vertices
from drape.garment.sleeves import covers_arms
from drape.garment.wearer_fields import DENSE_COUNT, bones_of, cloth_points
from drape.geometry import meshes
from drape.geometry.closest import nearest_vertices

FINE_VERTEX_MINIMUM, FINE_VERTEX_LIMIT = 3_000, 40_000
CARRIED_SCALES, INSIDE_SHARE = 1.0 + 0.02 * np.arange(11), 0.001  # scales of a hat; share of it in the skin
CARRIED_COUNT = 400  # points on what bones carry
FINE_EDGE_M = 0.021  # each round halves the edges: the mean ends near 15 mm
_MANTLE_ARRAYS = ("arm_share", "arm_ways")
_VERTEX_ARRAYS = ("vertices", "chart_patch", "chart_uv", "chart_weight", "chart_residual")


@dataclass(frozen=True, eq=False)
class RestMesh:
    """A garment's mesh at rest on the standard body, clear of it; V delivered vertices.

    ``mesh``: the cloth without unused vertices, in metres on the avatar. ``kept`` (V,): the row in ``mesh`` of every
    delivered vertex. ``faces``: the delivered faces. ``vertices`` [m] (N, 3): the vertices of ``mesh`` at rest, then
    those that subdivision added. ``fine_faces`` (G, 3): the subdivided triangles. ``loose`` (N,) in [0, 1]: how much
    each vertex hangs as a skirt does. ``resized``: the garment was moved from another body. ``figures``, for log and
    manifest: "avatar_residual_mm", "clearance_mm", "push_max_mm", "loose_share", "fine_vertex_count", and what
    ``edge_strain`` returns, with "move_" before its names, "push_", and "total_" for both.

    ``drawn``: the delivered mesh, bound to the cloth, where the cloth is another mesh; else None. ``carriers``: the
    names of the bones that carry the garment rigidly, none for cloth. Only of a mantle: ``arm`` (N,), the shares of the
    arms in [0, 1]; ``lay`` [m] (N, 3), where its cloth is without strain; ``shapes`` [m] (K, N, 3), over arms along the
    K ``mantle_shapes.DIRECTIONS``.
    """

    mesh: GarmentMesh
    kept: np.ndarray
    faces: np.ndarray
    vertices: np.ndarray
    fine_faces: np.ndarray
    loose: np.ndarray
    resized: bool
    figures: dict[str, float]
    drawn: BoundMesh | None = None
    carriers: tuple[str, ...] = ()
    arm: np.ndarray | None = None
    lay: np.ndarray | None = None
    shapes: np.ndarray | None = None


def rest_mesh(
    mesh: GarmentMesh,
    sheets: GarmentMesh,
    avatar: Avatar,
    body: BodyModel,
    *,
    sewn: bool = False,
    outer: np.ndarray | None = None,
    carriers: tuple[str, ...] | None = None,
) -> RestMesh:
    """Returns the cloth of ``sheets``, moved from ``avatar`` to ``body`` in T-pose, subdivided and pushed clear of the
    body. ``sheets``: ``join_sheets`` of the delivered ``mesh``, checked and in metres on the avatar.

    ``outer`` (F,) bool: the ``outer_sides`` of the sheets; ``carriers``: what ``bones_that_carry`` returns for them.
    These two are computed if left out. Of a mesh that is ``sewn`` every face is cloth. Raises ``MeshError`` where the
    mesh cannot be draped.
    """
    if carriers is None:
        carriers = () if sewn else bones_that_carry(with_used_vertices(sheets), avatar.vertices, body)
    cloth = sheets if sewn else cloth_layer(sheets, avatar.vertices, outer)
    whole = cloth is sheets and len(sheets.vertices) == len(mesh.vertices)
    checked = check_mesh(cloth if whole else with_used_vertices(cloth), avatar, carried=bool(carriers))
    joints = body.regressor @ avatar.vertices
    drawn = None if whole else hung(mesh, sheets.vertices[: len(mesh.vertices)], checked, joints, avatar.vertices)
    compact, kept = without_unused(checked)
    if carriers:
        moved = _carried(compact, avatar, body, carriers)
        compact = compact.noted(warning(f"carried by the bones {', '.join(carriers)}, as no cloth is"))
    elif _is_mantle(compact, avatar, body):
        moved = spread(compact.vertices, compact.faces, avatar, body)
        compact = compact.noted("it covers arms without sleeves: it hangs from them as they go up and down")
    else:
        moved = to_standard(compact.vertices, compact.faces, avatar, body)
    fine, fine_faces, origin = refine(
        moved.vertices, compact.faces, at_least=FINE_VERTEX_MINIMUM, at_most=FINE_VERTEX_LIMIT, edge_m=FINE_EDGE_M
    )
    if carriers:
        cleared = Cleared(fine, CLEARANCE_M, 0.0, 0)
    else:
        cleared = clear_body(fine, fine_faces, body.v_template, body.faces, through=avatar.moved)
    if cleared.clearance_m < CLEARANCE_M:
        compact = compact.noted(f"{1e3 * cleared.clearance_m:.1f} mm from the skin where it is nearest")
    delivered, final = compact.vertices, cleared.vertices[: len(compact.vertices)]
    figures = {
        "avatar_residual_mm": avatar.residual_mm,
        "clearance_mm": 1e3 * cleared.clearance_m,
        "push_max_mm": 1e3 * cleared.push_m,
        **{f"move_{k}": v for k, v in edge_strain(delivered, moved.vertices, compact.faces).items()},
        **{f"push_{k}": v for k, v in edge_strain(fine, cleared.vertices, fine_faces).items()},
        **{f"total_{k}": v for k, v in edge_strain(delivered, final, compact.faces).items()},
        "loose_share": float((moved.loose > 0.5).mean()),
        "fine_vertex_count": len(fine),
    }
    return RestMesh(
        compact,
        kept,
        checked.faces,
        cleared.vertices,
        fine_faces,
        moved.loose[origin],
        avatar.moved,
        figures,
        drawn,
        carriers,
        **_of_mantle(moved, compact.faces, len(fine_faces)),
    )


def _carried(mesh: GarmentMesh, avatar: Avatar, body: BodyModel, carriers: tuple[str, ...]) -> MovedGarment:
    """What bones carry, where these are in T-pose, and as large as that the skin is not in it; shoes, and what else the
    skin would be in, on their seat."""
    rows = carried_rows(mesh.vertices, mesh.faces, body.regressor @ avatar.vertices, carriers)
    rotations, translations = bone_motions(avatar.vertices, body.v_template, body.weights)
    moved = np.einsum("vab,vb->va", rotations[rows], mesh.vertices) + translations[rows]
    seat = Seat(body.v_template, body)
    for row in np.unique(rows):
        own, bone = rows == row, JOINT_NAMES[row]
        points, _ = cloth_points(moved, mesh.faces[own[mesh.faces].all(axis=1)], CARRIED_COUNT)
        middle = 0.5 * (moved[own].min(axis=0) + moved[own].max(axis=0))
        scaled = [middle + scale * (points - middle) for scale in CARRIED_SCALES]
        ways = [np.zeros(3)] * len(scaled) + [seat.way(one, bone) for one in scaled]
        inside = np.array([(seat.distance(one + way) < 0.0).mean() for one, way in zip(2 * scaled, ways, strict=True)])
        inside[: len(scaled)] += 1.0 if bone.endswith("ankle") else 0.0
        best = int(np.argmax(inside <= inside.min() + INSIDE_SHARE))
        moved[own] = middle + CARRIED_SCALES[best % len(scaled)] * (moved[own] - middle) + ways[best]
    return MovedGarment(moved, np.zeros(len(moved)))


def _is_mantle(mesh: GarmentMesh, avatar: Avatar, body: BodyModel) -> bool:
    points, _ = cloth_points(mesh.vertices, mesh.faces, DENSE_COUNT)
    return covers_arms(points, bones_of(body.regressor @ avatar.vertices, avatar.vertices))


def _of_mantle(moved: MovedGarment, faces: np.ndarray, face_count: int) -> dict[str, np.ndarray]:
    """The fields of a ``RestMesh`` of a mantle alone, whose ``faces`` are subdivided into ``face_count``."""
    if moved.arm is None or moved.lay is None or moved.shapes is None:
        return {}
    arm, coarse = moved.arm, faces
    while len(coarse) < face_count:
        arm, coarse, _ = meshes.subdivide(arm, coarse)
    lay, *shapes = (subdivided_like(each, faces, face_count) for each in (moved.lay, *moved.shapes))
    return {"arm": arm, "lay": lay, "shapes": np.stack(shapes)}


def edge_strain(before: np.ndarray, after: np.ndarray, faces: np.ndarray) -> dict[str, float]:
    """Returns |length after / length before - 1| [%] of the edges of ``faces``: its mean as "strain_mean_pct", its 95th
    percentile as "strain_p95_pct"."""
    edges = meshes.unique_edges(faces)
    strain = 100.0 * np.abs(
        meshes.edge_lengths(after, edges) / np.maximum(meshes.edge_lengths(before, edges), 1e-9) - 1.0
    )
    return {"strain_mean_pct": float(strain.mean()), "strain_p95_pct": float(np.quantile(strain, 0.95))}


def without_unused(mesh: GarmentMesh) -> tuple[GarmentMesh, np.ndarray]:
    """Returns ``mesh`` without the vertices that no face uses, and for each old vertex its row (V,) in the new mesh;
    for one that was left out, the row of the nearest vertex."""
    used = np.unique(mesh.faces)
    if len(used) == len(mesh.vertices):
        return mesh, np.arange(len(used))
    _, kept = nearest_vertices(mesh.vertices, mesh.vertices[used])
    kept[used] = np.arange(len(used))
    return replace(mesh, vertices=mesh.vertices[used], faces=kept[mesh.faces]), kept


def with_unused(garment: Garment, faces: np.ndarray, kept: np.ndarray) -> Garment:
    """Returns ``garment``, which was made without unused vertices, with these back in their rows; they lie on the
    nearest vertices. ``faces`` (F, 3): the delivered triangles. ``kept`` (V,): the row of each delivered vertex in
    ``garment``, as ``without_unused`` returns it."""
    compact = garment.vertex_count
    if len(kept) == compact and (kept == np.arange(compact)).all():
        return garment
    row = np.concatenate([kept, np.arange(compact, len(garment.vertices))])
    place = np.empty(len(garment.vertices), dtype=np.int64)
    place[row[::-1]] = np.arange(len(row))[::-1]
    place[garment.faces.reshape(-1)] = faces.reshape(-1)  # a face's vertex is the delivered one, not a copy of it
    named = [name for name in (*_VERTEX_ARRAYS, *_MANTLE_ARRAYS) if getattr(garment, name) is not None]
    arrays = {name: getattr(garment, name)[row] for name in named}
    fine_faces = place[garment.fine_faces].astype(np.int32)
    return replace(garment, vertex_count=len(kept), faces=faces.astype(np.int32), fine_faces=fine_faces, **arrays)


def describe_rest(rest: RestMesh) -> list[str]:
    """Returns lines for the log of intake: the notes of the mesh, and how far it was stretched and pushed."""
    figures = rest.figures
    lines = [f"note      {note}" for note in rest.mesh.notes]
    for step, what in (("move", "moved"), ("push", "cleared"), ("total", "in all")):
        mean, most = figures[f"{step}_strain_mean_pct"], figures[f"{step}_strain_p95_pct"]
        lines.append(f"{what:9s} edge strain {mean:.1f} % (95th percentile {most:.1f} %)")
    lines.append(
        f"clearance {figures['clearance_mm']:.2f} mm at least; pushed by {figures['push_max_mm']:.1f} mm at most"
    )
    return lines
