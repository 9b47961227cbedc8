"""Moves a garment from the avatar it was modelled on to the standard body in T-pose (paper, appendix A.2).

The paper moves every vertex by the displacement of its closest body vertex. Between an
A-pose and a T-pose that displacement changes along an arm by half a metre and shears a
sleeve, so it is split: each bone's rigid motion (Procrustes over the bone's skin) acts on
the garment like skinning, and only what is left, the change of shape, is a displacement.

    x' = sum_j w_j(x) (R_j x + t_j) + d(x)

Weights and displacement come from the avatar's surface near x and are smoothed over the
garment, so detail stays and neighbours move alike. Skirts, which enclose both legs, do not
follow the legs' rotation: below the hips they take the shape difference only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.garment.avatars import Avatar
from drape.garment.skin import ARMS
from drape.garment.sleeves import SHOULDER, sleeve_of
from drape.geometry import mesh_graphs, meshes
from drape.geometry.closest import closest_point, nearest_vertices
from drape.geometry.symmetric import symmetric_factor
from drape.motion.node_clip import nearest_rotations

WEIGHT_SMOOTHING_M = 0.05  # a longer one spreads an armpit's strain further
SHAPE_SMOOTHING_M = 0.03  # a longer one keeps the avatar's bust on a body that has none, which then creases
NEAR_COUNT = 48  # body vertices that a garment vertex may follow
SPREAD_MIN_M = 0.015
SPREAD_PER_DISTANCE = 0.7  # cloth far from the skin follows a wider part of it
LEGS = {
    side: [JOINT_NAMES.index(f"{side}_{part}") for part in ("hip", "knee", "ankle", "foot")]
    for side in ("left", "right")
}
TROUSERS_CROTCH_M = 0.08  # trousers hang at most this far below the body's crotch before their legs part
SKIRT_SHARE = 0.2  # a skirt has this share of its cloth below the crotch at each leg
HIP_BAND_M = 0.10
LEAST_TRUST = 1e-3  # weight by which cloth that is all skirt stays where its shape puts it
PN_LIMIT = 0.15  # a subdivision vertex leaves its edge by at most this share of the edge's length
DENSE = 0.6  # cloth with edges below this share of the usual ones may have fewer vertices


@dataclass(frozen=True, eq=False)
class MovedGarment:
    """A garment's ``vertices`` [m] (V, 3) on the standard body in T-pose, and ``loose`` (V,) in [0, 1], how much each
    hangs as a skirt does. Only of a mantle: ``arm`` (V,), the shares of the arms in [0, 1]; ``lay`` [m] (V, 3), the
    mantle on the standard body in its wearer's pose; ``shapes`` [m] (K, V, 3), the mantle over arms along each of
    ``mantle_shapes.DIRECTIONS``."""

    vertices: np.ndarray
    loose: np.ndarray
    arm: np.ndarray | None = None
    lay: np.ndarray | None = None
    shapes: np.ndarray | None = None


def bone_motions(source: np.ndarray, target: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns for each bone the rotation (J, 3, 3) and the translation [m] (J, 3), x' = R x + t, that bring its skin
    best from ``source`` to ``target`` [m] (V, 3). ``weights`` (V, J): the skin's bone weights. It is weighted least
    squares; a bone without skin takes the motion of the whole body."""
    share = weights**2  # the blended rim of a bone says less about it than its middle
    share = np.where(share.sum(axis=0) > 1e-9, share, 1.0)
    share = share / share.sum(axis=0)
    source_mean, target_mean = share.T @ source, share.T @ target
    moments = np.einsum("vj,va,vb->jab", share, target, source, optimize=True)
    rotations = nearest_rotations(moments - target_mean[:, :, None] * source_mean[:, None, :])
    return rotations, target_mean - np.einsum("jab,jb->ja", rotations, source_mean)


def to_standard(vertices: np.ndarray, faces: np.ndarray, avatar: Avatar, body: BodyModel) -> MovedGarment:
    """Returns the garment with ``vertices`` [m] (V, 3) and ``faces`` (F, 3), which lies on ``avatar``, moved to the
    standard ``body`` in T-pose. On an avatar that is the standard body the vertices stay."""
    skirt = skirt_blend(vertices, faces, avatar, body)
    if not avatar.moved:
        return MovedGarment(vertices.copy(), skirt)
    sleeve = sleeve_of(vertices, faces, body.regressor @ avatar.vertices, avatar.vertices)
    skirt = np.where(sleeve == 0, skirt, 0.0)  # a cuff that hangs below the crotch is no skirt
    averaging = own_skin_weights(vertices, sleeve, avatar, body)
    moved = moved_with_skin(vertices, faces, averaging, avatar, body, body.v_template)
    if skirt.any():
        hung = _shape_only(vertices, avatar, body)
        hung += _carried_on(moved - hung, skirt == 0.0, vertices, faces)
        moved += skirt[:, None] * (hung - moved)
    return MovedGarment(moved, skirt)


def _carried_on(gap: np.ndarray, above: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns ``gap`` (V, 3) of the vertices ``above`` (V,) a skirt, carried on smoothly over those of the skirt."""
    system = scipy.sparse.diags(above + LEAST_TRUST) + _laplacian(vertices, faces, SHAPE_SMOOTHING_M)
    return symmetric_factor(system).solve(above[:, None] * gap)


def moved_with_skin(
    vertices: np.ndarray,
    faces: np.ndarray,
    averaging: scipy.sparse.csr_matrix,
    avatar: Avatar,
    body: BodyModel,
    skin: np.ndarray,
) -> np.ndarray:
    """Returns the vertices [m] (V, 3) of a garment after the skin below it has moved from ``avatar`` to ``skin`` [m]
    (B, 3), which is another pose and shape of the avatar's B vertices. ``vertices`` and ``faces``: the garment on
    ``avatar``. ``averaging`` (V, B): how much each vertex of the garment follows each of the skin's, rows summing to
    one."""
    weights = body.weights
    rotations, translations = bone_motions(avatar.vertices, skin, weights)
    skinned = np.einsum("vj,jab,vb->va", weights, rotations, avatar.vertices, optimize=True) + weights @ translations
    garment_weights = smoother(vertices, faces, WEIGHT_SMOOTHING_M)(averaging @ weights)
    displacement = smoother(vertices, faces, SHAPE_SMOOTHING_M)(averaging @ (skin - skinned))
    garment_weights = garment_weights / garment_weights.sum(axis=1, keepdims=True)
    moved = np.einsum("vj,jab,vb->va", garment_weights, rotations, vertices, optimize=True)
    return moved + garment_weights @ translations + displacement


def own_skin_weights(
    vertices: np.ndarray, sleeve: np.ndarray, avatar: Avatar, body: BodyModel
) -> scipy.sparse.csr_matrix:
    """Returns the sparse ``surface_weights`` (V, B) of a garment's vertices over the B vertices of ``avatar``: for
    sleeves on the skin of their arm, for other cloth on all skin but arms. ``sleeve`` (V,): what ``sleeve_of`` returns.
    A hand that hangs beside a skirt is nearer to it than the thigh is, and would take it along."""
    arms = [body.weights[:, bones].sum(axis=1) for bones in ARMS.values()]
    counts = [sum(arms) < 0.5, *(arm > 0.05 for arm in arms), None]
    rows = [np.flatnonzero(sleeve == number) for number in range(SHOULDER + 1)]
    blocks = [surface_weights(vertices[row], avatar, counts[number]) for number, row in enumerate(rows) if len(row)]
    back = np.argsort(np.concatenate(rows))
    return scipy.sparse.vstack(blocks).tocsr()[back]


def surface_weights(points: np.ndarray, avatar: Avatar, counts: np.ndarray | None = None) -> scipy.sparse.csr_matrix:
    """Returns sparse weights (N, B), rows summing to one, that average values of the B vertices of ``avatar`` near each
    of ``points`` [m] (N, 3): a Gaussian round the point, over skin whose normal agrees with that of the nearest skin.
    ``counts`` (B,) bool: the skin that may have weight, all by default."""
    counts = np.ones(len(avatar.vertices), dtype=bool) if counts is None else counts
    skin, faces = np.flatnonzero(counts), avatar.faces[counts[avatar.faces].all(axis=1)]
    normals = meshes.vertex_normals(avatar.vertices, avatar.faces)
    distance, near = nearest_vertices(points, avatar.vertices[skin], NEAR_COUNT)
    near = skin[near]
    closest = closest_point(points, avatar.vertices, faces)
    corner = faces[closest.face]
    facing = np.einsum("vk,vkc->vc", closest.barycentric, normals[corner])
    agreement = np.maximum(np.einsum("vc,vkc->vk", facing, normals[near]), 0.0)
    spread = np.maximum(SPREAD_MIN_M, SPREAD_PER_DISTANCE * closest.distance)[:, None]
    value = agreement * np.exp(-0.5 * (distance**2 - closest.distance[:, None] ** 2) / spread**2)
    rows = np.repeat(np.arange(len(points)), NEAR_COUNT)
    gathered = scipy.sparse.csr_matrix(
        (value.reshape(-1), (rows, near.reshape(-1))), shape=(len(points), len(avatar.vertices))
    )
    # The closest point itself always counts, so no row is empty.
    own = scipy.sparse.csr_matrix(
        (closest.barycentric.reshape(-1), (np.repeat(np.arange(len(points)), 3), corner.reshape(-1))),
        shape=gathered.shape,
    )
    total = gathered + own
    return scipy.sparse.diags(1.0 / np.asarray(total.sum(axis=1)).reshape(-1)) @ total


def smoother(vertices: np.ndarray, faces: np.ndarray, length_m: float):
    """Returns a function that smooths values (V, C) at the vertices along the mesh over ``length_m``, in which
    constants stay: it multiplies by (I + length^2 L)^-1."""
    return symmetric_factor(scipy.sparse.identity(len(vertices)) + _laplacian(vertices, faces, length_m)).solve


def _laplacian(vertices: np.ndarray, faces: np.ndarray, length_m: float) -> scipy.sparse.csr_matrix:
    edges = meshes.unique_edges(faces)
    inverse_square = (length_m / np.maximum(meshes.edge_lengths(vertices, edges), 1e-4)) ** 2
    # About six neighbours lie in the plane: a third of the sum is the Laplacian's scale.
    return mesh_graphs.weighted_laplacian(mesh_graphs.edge_matrix(edges, inverse_square, len(vertices))) / 3.0


def skirt_blend(vertices: np.ndarray, faces: np.ndarray, avatar: Avatar, body: BodyModel) -> np.ndarray:
    """Returns the share (V,) in [0, 1] to which each vertex belongs to a skirt on ``avatar``: smoothly from 0 above the
    hip joints to 1 below the crotch, and 0 for other cloth. A skirt is a connected piece of cloth below the crotch that
    lies round both legs; trousers fall into two pieces there."""
    joints = body.regressor @ avatar.vertices
    sides = {side: body.weights[:, bones].sum(axis=1) for side, bones in LEGS.items()}
    thighs = (sides["left"] + sides["right"]) > 0.5
    middle = 0.5 * (joints[LEGS["left"][0], 0] + joints[LEGS["right"][0], 0])
    width = abs(joints[LEGS["left"][0], 0] - joints[LEGS["right"][0], 0])
    inner = avatar.vertices[thighs & (np.abs(avatar.vertices[:, 0] - middle) < 0.15 * width)]
    hips = 0.5 * (joints[LEGS["left"][0], 1] + joints[LEGS["right"][0], 1])
    crotch = min(float(inner[:, 1].max()), hips - 0.02) if len(inner) else hips - 0.08
    blend = np.zeros(len(vertices))
    below = (vertices[faces][:, :, 1] < crotch - TROUSERS_CROTCH_M).all(axis=1)
    if not below.any():
        return blend
    closest = closest_point(vertices, avatar.vertices, avatar.faces)
    side = np.stack(
        [np.einsum("vk,vk->v", closest.barycentric, sides[s][avatar.faces[closest.face]]) for s in ("left", "right")]
    )
    piece = mesh_graphs.connected_components(faces[below], len(vertices))
    used = np.unique(faces[below])
    component = mesh_graphs.connected_components(faces, len(vertices))
    ramp = np.clip((hips - vertices[:, 1]) / (hips - crotch), 0.0, 1.0)
    for number in np.unique(piece[used]):
        members = used[piece[used] == number]
        share = (side[:, members] > 0.5).mean(axis=1)
        if share.min() > SKIRT_SHARE:
            whole = np.isin(component, np.unique(component[members]))
            blend = np.maximum(blend, np.where(whole, ramp, 0.0))
    return blend * blend * (3.0 - 2.0 * blend)


def _shape_only(vertices: np.ndarray, avatar: Avatar, body: BodyModel) -> np.ndarray:
    """Vertices moved with the pelvis and by the bodies' hips and legs, whatever the legs' pose.

    Across, what stands off the hips keeps its distance from them, as cloth above does: scaled, a wide skirt had a step
    at the crotch of narrow hips.
    """
    source, target = avatar.vertices, body.v_template
    hips = [LEGS["left"][0], LEGS["right"][0]]
    joints = [body.regressor @ shape for shape in (source, target)]
    rotation, _ = bone_motions(source, target, body.weights)
    turned = source @ rotation[0].T
    centre = joints[0][hips].mean(axis=0) @ rotation[0].T, joints[1][hips].mean(axis=0)
    # Above the hip joints the legs' pose does not show in the body's width.
    pelvis = body.weights[:, [0, *hips]].sum(axis=1) > 0.5
    pelvis &= (turned[:, 1] > centre[0][1]) & (turned[:, 1] < centre[0][1] + HIP_BAND_M)
    size = np.ptp(turned[pelvis], axis=0)
    scale = np.ptp(target[pelvis], axis=0) / size
    leg = [np.linalg.norm(j[LEGS["left"][2]] - j[LEGS["left"][0]]) for j in joints]
    scale[1] = leg[1] / leg[0]
    at = vertices @ rotation[0].T - centre[0]
    out = np.linalg.norm((at / (0.5 * size))[:, ::2], axis=1)  # 1 at the hips' sides
    on_hips = at.copy()
    on_hips[:, ::2] /= np.maximum(out, 1.0)[:, None]
    return at + on_hips * (scale - 1.0) + centre[1]


def subdivide_smooth(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns vertices [m] (N, 3), faces (4F, 3) and the two parents (N, 2) of each vertex after one round of
    subdivision, in the order of ``meshes.subdivide``. Old vertices stay in place. A new vertex is the middle of the
    cubic edge of a PN triangle (Vlachos et al. 2001), which turns facets into a round surface; but it leaves its edge
    by at most ``PN_LIMIT`` of its length, and by less where the normals of both ends are over 60 degrees apart."""
    flat, fine, parents = meshes.subdivide(vertices, faces)
    normals = meshes.vertex_normals(vertices, faces)
    a, b = parents[len(vertices) :].T
    edge = vertices[b] - vertices[a]
    along_a = np.einsum("ec,ec->e", edge, normals[a])
    along_b = np.einsum("ec,ec->e", edge, normals[b])
    lift = (along_b[:, None] * normals[b] - along_a[:, None] * normals[a]) / 8.0
    # At a fold the two normals disagree and the cubic says nothing.
    lift *= np.clip(np.einsum("ec,ec->e", normals[a], normals[b]) * 2.0, 0.0, 1.0)[:, None]
    size = np.linalg.norm(lift, axis=1)
    limit = PN_LIMIT * np.linalg.norm(edge, axis=1)
    flat[len(vertices) :] += lift * np.minimum(1.0, limit / np.maximum(size, 1e-12))[:, None]
    return flat, fine, parents


def refine(
    vertices: np.ndarray, faces: np.ndarray, *, at_least: int, at_most: int, edge_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns vertices [m] (N, 3), faces (G, 3) and for each vertex the row (N,) of a delivered vertex from which it
    descends, after rounds of ``subdivide_smooth``. It goes on until the mean edge is at most ``edge_m`` and there are
    ``at_least`` vertices, but not past ``at_most``. Half of ``at_least`` suffice where the mean edge is at most
    ``DENSE`` times ``edge_m``."""
    origin = np.arange(len(vertices))
    while True:
        edges = meshes.unique_edges(faces)
        mean_m = meshes.edge_lengths(vertices, edges).mean()
        wanted = at_least if mean_m > DENSE * edge_m else at_least // 2
        grown = len(vertices) + len(edges)
        if not ((len(vertices) < wanted or mean_m > edge_m) and grown <= at_most):
            return vertices, faces, origin
        vertices, faces, parents = subdivide_smooth(vertices, faces)
        origin = origin[parents[:, 0]]
