"""Bodies that a garment of unknown origin may have been modelled on, each with its distances on a grid.

A reading of a file is judged by three things: cloth inside the skin, cloth far from it, and limbs that the cloth does
not go round. Distances come from a grid of 25 mm, so ten thousand readings take a second; whether a bone is enclosed is
asked of the directions in which cloth lies round it, which neither thickness nor buttons nor reversed faces disturb.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import scipy.ndimage
import scipy.sparse

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES
from drape.forked import each
from drape.garment.contours import bone_chains
from drape.garment.registration import FREE_JOINTS, posed_by, start_parameters, unpack_parameters
from drape.geometry import meshes

CELL_M = 0.025
MARGIN_M = 0.2  # of the grid around the body
ROOM = 28  # cells around that grid, where cloth is far from the body
MARGIN_CELLS = round(MARGIN_M / CELL_M) - 2  # cells at every side of the grid that are outside the body
FREE_M = 0.01  # cloth as delivered is this deep in the skin here and there
DEEP_M, DEEP_MOST = 0.02, 4.0  # depth that costs 1; most that a point of cloth costs
FAR_M = 0.08  # distance outside that costs 0.5; far outside it is 1
THIN_M = 0.02  # spacing of the skin's points in a fit
# Shapes of the standard body: anny's and MakeHuman's young adults, by registration.fit_body of their phenotypes.
SHAPES = {
    "standard": (0.0,) * 10,
    "person": (0.097, -1.066, -0.517, 0.677, 0.470, -0.050, 0.035, -0.093, -0.746, -0.270),
    "man": (0.561, -2.137, 0.653, 0.815, -0.282, 0.006, 0.200, -0.176, -0.623, -0.719),
    "woman": (-0.357, 0.091, -1.416, 0.739, 1.396, -0.038, -0.208, 0.049, -0.890, 0.203),
    "small woman": (-1.190, 0.100, -1.400, 0.850, 1.500, -0.500, -0.300, 0.100, -0.800, 0.220),
}
BENT_RAD = 0.7  # bend of MakeHuman's elbows
# Shape, how far the arms hang below the horizontal [rad], how far the elbows are bent forward [rad], and the cost of
# such arms where cloth does not show them.
KNOWN = (
    ("standard", 0.0, 0.0, 0.0),
    ("small woman", 0.0, 0.0, 0.01),
    ("woman", 0.84, BENT_RAD, 0.01),
    ("small woman", 0.84, BENT_RAD, 0.01),
    ("man", 0.84, BENT_RAD, 0.01),
    ("person", 0.42, 0.0, 0.03),
    ("person", 0.8, 0.0, 0.02),
    ("person", 1.2, 0.0, 0.03),
    ("small woman", 1.35, 0.2, 0.03),
    ("standard", -0.8, 0.0, 0.04),
)
# Bones with the number of points on each, how far cloth on them may lie away [m], and the joints at their ends.
BONES = (
    ("trunk", 7, 0.6, "pelvis", "neck"),
    ("head", 4, 0.4, "neck", "crown"),
    *((f"{side} arm", 3, 0.3, f"{side}_shoulder", f"{side}_elbow") for side in ("left", "right")),
    *((f"{side} arm", 4, 0.3, f"{side}_elbow", f"{side}_hand") for side in ("left", "right")),
    *((f"{side} leg", 5, 0.8, f"{side}_hip", f"{side}_knee") for side in ("left", "right")),
    *((f"{side} leg", 5, 0.8, f"{side}_knee", f"{side}_ankle") for side in ("left", "right")),
    *((f"{side} leg", 2, 0.3, f"{side}_ankle", f"{side}_foot") for side in ("left", "right")),
)
CROWN = 1.3  # height of the head above its joint, over the way from the neck to the joint
SLAB_M = 0.06  # cloth this far along a bone from one of its points lies round it
DENSE_COUNT = 4000  # points on the cloth, for what a line between limbs and trunk meets
BIN_COUNT = 12  # directions round a bone; a point of cloth covers its own and both neighbours


@lru_cache(maxsize=2)
def thin_body(body: BodyModel) -> BodyModel:
    """Returns ``body`` with one vertex for every ``THIN_M`` of skin and without pose blend shapes, for fits in little
    time. Its joints are those of ``body`` in every shape and pose."""
    cell = np.floor(body.v_template / THIN_M).astype(np.int64)
    _, first, label = np.unique(cell, axis=0, return_index=True, return_inverse=True)
    faces = label.reshape(-1)[body.faces]
    kept = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    shapes, joints = body.shapedirs[first], body.joint_shapedirs
    # Any regressor that gives the joints of every shape will do; this is the least one.
    known = np.concatenate([body.v_template[first], shapes.reshape(len(first), -1), np.ones((len(first), 1))], axis=1)
    wanted = np.concatenate([body.joints_template, joints.reshape(JOINT_COUNT, -1), np.ones((JOINT_COUNT, 1))], axis=1)
    regressor = np.linalg.lstsq(known.T, wanted.T, rcond=None)[0].T
    return replace(
        body,
        v_template=body.v_template[first],
        shapedirs=shapes,
        weights=body.weights[first],
        faces=np.unique(faces[kept], axis=0),
        regressor=scipy.sparse.csr_matrix(regressor),
        posedirs=None,
    )


def known_parameters(body: BodyModel, shape: str, lift_rad: float, bent_rad: float) -> np.ndarray:
    """Returns the parameters (P,), betas, joint rotations [rad] and translation [m] as in ``unpack_parameters``, of a
    known body: of the ``shape`` named in ``SHAPES``, with arms ``lift_rad`` below the horizontal and elbows bent
    forward by ``bent_rad``, not translated."""
    parameters = start_parameters(body, lift_rad, np.zeros(3))
    count = min(body.shape_count, len(SHAPES[shape]))
    parameters[:count] = SHAPES[shape][:count]
    for side, sign in (("left", -1.0), ("right", 1.0)):
        elbow = FREE_JOINTS.index(JOINT_NAMES.index(f"{side}_elbow"))
        parameters[body.shape_count + 3 * elbow + 1] = sign * bent_rad
    return parameters


@dataclass(frozen=True, eq=False)
class Bones:
    """B points along the bones of a posed body: ``at`` [m] (B, 3), and ``frames`` (B, 3, 3), whose rows are unit
    vectors, the last one along the bone. ``radius`` [m] (B,): that of the limb there. ``reach`` [m] (B,): how far from
    the bone its cloth may lie. ``part``: the part of the body of each point ("trunk", "left arm", ...). ``joints`` [m]
    (24, 3): the body's."""

    at: np.ndarray
    frames: np.ndarray
    reach: np.ndarray
    radius: np.ndarray
    part: tuple[str, ...]
    joints: np.ndarray


@dataclass(frozen=True, eq=False)
class Field:
    """What it costs, without unit, that cloth lies at a place around a posed body. ``cost`` (X, Y, Z) float32: the
    ``point_cost`` in each cell of a grid along x, y and z; a cell is ``CELL_M`` wide. ``low`` [m] (3,): the middle of
    the first cell. ``parameters`` (P,) of the body as in ``unpack_parameters``; ``bones``: points along its bones.
    ``floor_m`` and ``top_m``: the heights of its soles and its crown."""

    parameters: np.ndarray
    cost: np.ndarray
    low: np.ndarray
    bones: Bones
    floor_m: float
    top_m: float

    def costs(self, points: np.ndarray, rises: np.ndarray, depths: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Returns the costs (R, D) of cloth that is moved by whole cells: by each of ``rises`` (R,) up and each of
        ``depths`` (D,) forward. ``points`` [m] (N, 3): the cloth before. A cost is the sum of ``cost`` in the cells of
        the points, each times its ``weight`` (N,)."""
        shape = np.array(self.cost.shape)
        room = np.stack([[0, -rises.min(initial=0), -depths.min()], [0, rises.max(initial=0), depths.max()]])
        cell = np.rint((points - self.low) / CELL_M).astype(np.int32)
        cell = np.clip(cell, np.maximum(room[0], 0), shape - 1 - np.maximum(room[1], 0)).astype(np.int32)
        flat = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
        moves = (rises[:, None] * shape[2] + depths[None]).reshape(-1)
        return (self.cost.reshape(-1)[flat[None] + moves[:, None]] @ weight).reshape(len(rises), len(depths))


def point_cost(distance: np.ndarray) -> np.ndarray:
    """Returns the cost, without unit, of a point of cloth at the signed ``distance`` [m] from the skin, of the same
    shape: 0 within ``FREE_M`` of the skin, rising to 1 far outside and to ``DEEP_MOST`` (4) inside."""
    depth = np.clip((-distance - FREE_M) / DEEP_M, 0.0, DEEP_MOST)
    outside = np.maximum(distance - FREE_M, 0.0) ** 2
    return depth + outside / (outside + FAR_M**2)


def bones_of(posed: np.ndarray, skin: np.ndarray) -> Bones:
    """Returns points along the bones of a body that has the joints ``posed`` [m] (24, 3) and the points ``skin`` [m]
    (V, 3)."""
    joints = dict(zip(JOINT_NAMES, posed, strict=True))
    joints["crown"] = joints["head"] + CROWN * (joints["head"] - joints["neck"])
    at, axis, reach, part = [], [], [], []
    for name, count, far, start, end in BONES:
        way = joints[end] - joints[start]
        share = (np.arange(count) + 0.5) / count
        at.append(joints[start] + share[:, None] * way)
        axis.append(np.repeat(way[None] / np.linalg.norm(way), count, axis=0))
        reach += [far] * count
        part += [name] * count
    points, last = np.concatenate(at), np.concatenate(axis)
    helper = np.eye(3)[np.abs(last).argmin(axis=1)]
    first = np.cross(helper, last)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    frames = np.stack([first, np.cross(last, first), last], axis=1)
    along = skin @ last.T - np.einsum("bc,bc->b", last, points)  # (V, B)
    square = (skin**2).sum(axis=1)[:, None] - 2.0 * skin @ points.T + (points**2).sum(axis=1) - along**2
    near = (np.abs(along) < SLAB_M / 2) & (square < (np.array(reach) / 2) ** 2)
    radius = np.array(
        [np.median(square[mask, number]) if mask.any() else 0.05**2 for number, mask in enumerate(near.T)]
    )
    radius = np.sqrt(np.clip(radius, 0.0, 0.16**2))
    return Bones(points, frames, np.array(reach), radius, tuple(part), posed)


def enclosed(points: np.ndarray, bones: Bones) -> tuple[np.ndarray, np.ndarray]:
    """Returns for each of ``points`` [m] (N, 3) on cloth two arrays (N,): the share in [0, 1] of the directions around
    its bone in which there is cloth, and the row in ``bones`` of the point on a bone that is nearest to it."""
    frames = bones.frames.astype(np.float32)
    local = (
        points.astype(np.float32) @ frames.transpose(0, 2, 1)
        - np.einsum("bac,bc->ba", frames, bones.at.astype(np.float32))[:, None]
    )
    across = np.hypot(local[..., 0], local[..., 1])
    row, point = np.nonzero((np.abs(local[..., 2]) < SLAB_M) & (across < bones.reach[:, None]))
    turn = np.arctan2(local[row, point, 1], local[row, point, 0]) / (2.0 * np.pi) + 0.5
    bins = np.zeros((len(across), BIN_COUNT), dtype=bool)
    bins[row, np.floor(turn * BIN_COUNT).astype(np.int64) % BIN_COUNT] = True
    share = (bins | np.roll(bins, 1, axis=1) | np.roll(bins, -1, axis=1)).mean(axis=1)
    nearest = (np.hypot(across, local[..., 2]) - bones.radius[:, None]).argmin(axis=0)
    return share[nearest], nearest


def unthreaded(loops: np.ndarray, joints: np.ndarray) -> int:
    """Returns how many of the closed polylines ``loops`` [m] (L, n, 3) have none of ``bone_chains`` through them, which
    crosses the fan around a loop's mean more often one way than the other. ``joints`` [m] (24, 3)."""
    a, b = loops, np.roll(loops, -1, axis=1)
    c = np.broadcast_to(loops.mean(axis=1, keepdims=True), a.shape)
    normal = np.cross(b - a, c - a)
    threaded = np.zeros(len(loops), dtype=bool)
    for chain, _ in bone_chains(joints).values():
        net = np.zeros(len(loops))
        for start, end in pairwise(chain):
            rise = normal @ (end - start)
            t = ((a - start) * normal).sum(axis=2) / np.where(rise == 0.0, 1.0, rise)
            point = start + t[..., None] * (end - start)
            hit = (t >= 0.0) & (t < 1.0) & (rise != 0.0)
            for p, q in ((a, b), (b, c), (c, a)):
                hit &= (np.cross(q - p, point - p) * normal).sum(axis=2) >= 0.0
            net += (np.sign(rise) * hit).sum(axis=1)
        threaded |= net != 0.0
    return int((~threaded).sum())


def joints_of(body: BodyModel, parameters: np.ndarray) -> np.ndarray:
    """Returns the joints [m] (24, 3) of ``body`` with ``parameters`` (``unpack_parameters``), in the world."""
    betas, pose, trans = unpack_parameters(body, parameters)
    return body.posed_joints(pose[None], betas)[0] + trans


def field_of(body: BodyModel, parameters: np.ndarray) -> Field:
    """Returns the grid of the costs of cloth around ``body`` with ``parameters`` (P,), which are those of
    ``unpack_parameters``."""
    skin = posed_by(body, parameters)
    spread = np.array([(a, b, 3 - a - b) for a in range(4) for b in range(4 - a)]) / 3.0  # so that no cell is missed
    low = skin.min(axis=0) - MARGIN_M
    shape = np.ceil((skin.max(axis=0) + MARGIN_M - low) / CELL_M).astype(int) + 1
    solid = np.zeros(shape, dtype=bool)
    cells = np.tensordot(spread, (skin - low)[body.faces] / CELL_M, axes=(1, 1))
    solid[tuple(np.rint(cells).astype(np.int32).reshape(-1, 3).T)] = True
    solid = np.asarray(scipy.ndimage.binary_fill_holes(solid))
    # Cells that the skin passes through count as inside, so the surface lies half a cell within.
    distance = np.asarray(scipy.ndimage.distance_transform_edt(~solid))
    body_cells = (slice(MARGIN_CELLS, -MARGIN_CELLS),) * 3
    within = solid[body_cells]
    inside = np.asarray(scipy.ndimage.distance_transform_edt(within))
    distance[body_cells] = np.where(within, 1.0 - inside, distance[body_cells])
    distance *= CELL_M
    bones = bones_of(joints_of(body, parameters), skin[::6])
    cost = np.pad(point_cost(distance).astype(np.float32), ROOM, constant_values=1.0)
    low = low - ROOM * CELL_M
    return Field(parameters, cost, low, bones, float(skin[:, 1].min()), float(skin[:, 1].max()))


@lru_cache(maxsize=2)
def known_fields(body: BodyModel) -> tuple[Field, ...]:
    """Returns the costs of cloth around ``body`` in each of the shapes and poses ``KNOWN``, in their order."""
    return tuple(each(lambda one: field_of(body, known_parameters(body, *one[:3])), KNOWN))


def cloth_points(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns points (``count``, 3) spread evenly over the mesh by area, and the faces (``count``,) that they lie on.
    The points are in the unit of ``vertices``; the same mesh gives the same points."""
    areas = np.cumsum(meshes.face_areas(vertices, faces))
    draw = np.random.default_rng(0)
    face = np.searchsorted(areas, areas[-1] * (np.arange(count) + draw.random(count)) / count)
    face = np.minimum(face, len(faces) - 1)
    weight = np.sort(draw.random((count, 2)), axis=1)
    weight = np.stack([weight[:, 0], weight[:, 1] - weight[:, 0], 1.0 - weight[:, 1]], axis=1)
    return np.einsum("nk,nkc->nc", weight, vertices[faces[face]]), face
