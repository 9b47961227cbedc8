"""``drape.live.fold_step.fold`` once more, in NumPy float64 and vertex order, to be read and compared with."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drape.cloth.energies import ClothMesh
from drape.cloth.problem import Problem, problem
from drape.exact.surroundings import Around as Outside
from drape.exact.surroundings import surroundings
from drape.geometry import meshes
from drape.geometry.closest import closest_point
from drape.live.clock import step_between
from drape.live.fold_constants import HOLD, WornCloth
from drape.live.fold_step import FoldEffort, FoldMemory, Frame
from drape.live.room import FOLDED, NEAR_M, ROOM_M
from drape.live.sheet import ALIKE
from drape.live.skin_walks import SkinGraph, TouchedSamples
from drape.live.whole import stiffness
from tests.reference import carry
from tests.reference import pace as pacing
from tests.reference import solver as reference
from tests.reference.skin import TURNS, follow, laid_back, planes, touch

FIRST_STEP_S = 1.0 / 30.0  # of a frame without a past
SLIP_M, CLAMP_M = 1e-3, 0.02
FORGET, LACK, HEM, MEND_M = 24.0, 0.003, 24.0, 0.03
SPACING, KEPT, KEPT_M = 0.95, 0.5, 0.0085
OTHER, DEEP_M, TOO_DEEP_M = 0.25, 0.04, 0.06  # of the lift
LONGEST, SHORTEST, LIMIT_PASSES = 1.3, 0.7, 4


def fold(
    dressed: WornCloth, memory: FoldMemory | None, frame: Frame, effort: FoldEffort
) -> tuple[np.ndarray, FoldMemory]:
    """Vertices [m] (V, 3) of ``frame`` and its memory, in their order; ``memory`` is one that leads here, or None."""
    network, still = frame.vertices.astype(np.float64), np.zeros(frame.vertices.shape)
    nowhere = TouchedSamples(dressed.index, np.full_like(dressed.index, -1))
    past = memory or FoldMemory(frame.time_s, network, still, still, nowhere, still, 0)
    step_s = step_between(past.time_s, frame.time_s) if memory else FIRST_STEP_S
    frames = surface_frames(network, dressed.cloth)
    share = pacing.fading(effort.steps, step_s)
    then = surface_frames(past.network, dressed.cloth)
    off = _to_world(frames, share * past.residual)
    off = kept(off, past.network, network, dressed.cloth)
    x = network + off
    if memory and effort.steps:
        came = past.network + kept(_to_world(then, past.residual), past.network, network, dressed.cloth)
        turns = carry.surface_turns(then, frames, dressed.cloth.faces, carry.CARRY_PASSES)
        x = x + solved_step(dressed, carry.carry_energy(x, came, turns, dressed.cloth, dressed.material)[1])
    way = (share == 1.0) * step_s * _to_world(frames, past.velocity)
    stuck = stuck_places(past.grip, frame.skin, dressed.graph, past.touched.own)
    touched = follow(network, frame.skin, dressed.graph, past.touched)
    x = laid_back(x, network, frame.skin, touched.own)
    stiff = 0.5 * float(dressed.material.membrane[0] + dressed.material.membrane[1]) > pacing.STIFF_N_PER_M
    way_m = pacing.moved_m(past.network, network)
    friction = pacing.grip_left(way_m, step_s) * dressed.friction if memory else 0.0
    long = memory is None and effort.settle >= pacing.LONG_ROUNDS
    momentum = pacing.SETTLING_MOMENTUM if long else pacing.momentum_of(pacing.calmness(way_m), stiff=stiff)
    made = problem(dressed.cloth, dressed.material, dtype=np.float64)
    made = replace(made, hinges=made.creases)  # the others bend by the quadratic matrix
    for number in range(0 if effort.steps == 0 else 1 if memory else effort.settle):
        here, touched = touch(x, network, frame.skin, dressed.graph, touched, past.turn if memory else -1)
        around = touching(made, dressed, x, frame.skin, here)
        own = replace(around.own, band=network, band_n_per_m=dressed.band_n_per_m)
        around = around._replace(own=own, stuck=stuck, friction=friction)
        if effort.cloth_contact:
            around = kept_apart(x, around, made, dressed.cloth)
        for _ in range(0 if memory or number else effort.settle):
            x = sweep(x, made, around)
        for _ in range(effort.steps):
            ahead = x + momentum * _limited(way, float(made.constants.reach))
            ahead = ahead + whole_step(dressed, made, around, ahead)
            x, way = ahead, ahead - x
        for _ in range(effort.steps):
            x = sweep(x, made, around)
    if effort.clearance_m > 0.0:
        if effort.steps == 0:
            here, touched = touch(x, network, frame.skin, dressed.graph, touched, past.turn if memory else -1)
            around = touching(made, dressed, x, frame.skin, here)
        x = limited(lifted(x, around, effort.clearance_m), dressed.cloth)
    residual, velocity = _to_local(frames, x - network), _to_local(frames, way) / step_s
    grip = write_grip(x, stuck if memory else x, frame.skin, dressed.graph, touched.own)
    return x, FoldMemory(frame.time_s, network, residual, velocity, touched, grip, (past.turn + 1) % TURNS)


def surface_frames(surface: np.ndarray, cloth: ClothMesh) -> np.ndarray:
    """Frames (V, 3, 3) of ``surface`` [m] (V, 3), rows: the normal, an edge laid into the plane, and their product.

    The edge goes to ``longest_next``.
    """
    faces = cloth.faces
    across = np.cross(surface[faces[:, 1]] - surface[faces[:, 0]], surface[faces[:, 2]] - surface[faces[:, 0]])
    normal = np.zeros_like(surface)
    np.add.at(normal, faces, across[:, None])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    edge = surface[longest_next(cloth)] - surface
    edge -= (edge * normal).sum(axis=1, keepdims=True) * normal
    edge /= np.linalg.norm(edge, axis=1, keepdims=True)
    return np.stack([normal, edge, np.cross(normal, edge)], axis=1)


def kept(off: np.ndarray, before: np.ndarray, network: np.ndarray, cloth: ClothMesh) -> np.ndarray:
    """What is kept of residuals ``off`` [m] (V, 3) from one drape of the network to the next."""
    return evened(mended(off, cloth.faces, forgotten(before, network, cloth)), before, network, cloth.faces)


def rest_lengths(cloth: ClothMesh) -> np.ndarray:
    """The lengths at rest [m] (F, 3) of each triangle's edges, from each corner to the next."""
    a, b, c, d = cloth.inverse_shape
    shape = np.linalg.inv(np.stack([np.stack([a, c], axis=-1), np.stack([b, d], axis=-1)], axis=-2))  # columns: edges
    first, second = shape[..., 0], shape[..., 1]
    return np.linalg.norm(np.stack([first, second - first, -second], axis=1), axis=-1)


def longest_next(cloth: ClothMesh) -> np.ndarray:
    """The next corner (V,) of a triangle of each vertex: of those the one that is farthest at rest."""
    faces, length = cloth.faces, rest_lengths(cloth).reshape(-1)
    longest = np.zeros(cloth.vertex_count)
    np.maximum.at(longest, faces.reshape(-1), length)
    order = np.lexsort((length < ALIKE * longest[faces.reshape(-1)], faces.reshape(-1)))
    entry = order[np.unique(faces.reshape(-1)[order], return_index=True)[1]]
    return faces[entry // 3, (entry + 1) % 3]


def forgotten(before: np.ndarray, network: np.ndarray, cloth: ClothMesh) -> np.ndarray:
    """The share (V,) of its way from its neighbours' mean that a residual loses."""
    faces, other = cloth.faces, longest_next(cloth)
    across = np.cross(network[faces[:, 1]] - network[faces[:, 0]], network[faces[:, 2]] - network[faces[:, 0]])
    covered, whole = np.zeros(len(network)), np.zeros(len(network))
    for corner in faces.T:
        np.add.at(covered, corner, 0.5 * np.linalg.norm(across, axis=1))
        np.add.at(whole, corner, cloth.face_area)
    edge = network[other] - network
    turn = np.linalg.norm(edge - (before[other] - before), axis=1) / np.linalg.norm(edge, axis=1)
    s = FORGET * turn / (1.0 + (np.maximum(1.0 - covered / whole, 0.0) / LACK) ** 2)
    return s / (1.0 + s)


def mended(off: np.ndarray, faces: np.ndarray, lost: np.ndarray, *, far_m: float = MEND_M) -> np.ndarray:
    """``off`` (V, 3) moved by a share ``lost`` (V,) to the mean of the neighbours', each counted once for every
    triangle that it shares, and all the way where it is farther than ``far_m`` from that."""
    total, count = np.zeros_like(off), np.zeros(len(off))
    for corner in range(3):
        for other in (corner - 1, corner - 2):
            np.add.at(total, faces[:, corner], off[faces[:, other]])
            np.add.at(count, faces[:, corner], 1.0)
    way = total / count[:, None] - off
    return off + np.where(np.linalg.norm(way, axis=1) > far_m, 1.0, lost)[:, None] * way


def evened(off: np.ndarray, before: np.ndarray, network: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """``off`` (V, 3), at a border moved towards the mean of the two neighbours' along it."""
    out = off.copy()
    for loop in meshes.boundary_loops(faces):
        after = np.roll(loop, -1)
        edge, old = network[after] - network[loop], before[after] - before[loop]
        s = HEM * np.linalg.norm(edge - old, axis=1) / np.linalg.norm(edge, axis=1)
        mean = 0.5 * (off[np.roll(loop, 1)] + off[after])
        out[loop] += (s / (1.0 + s))[:, None] * (mean - off[loop])
    return out


def room(x: np.ndarray, cloth: ClothMesh, reach: float = ROOM_M) -> tuple[np.ndarray, np.ndarray]:
    """Distances [m] (V,) of ``x`` [m] (V, 3) to the nearest that is not of the sheet, and that one: ``reach`` and -1
    where none is within that."""
    a, b, c, d = cloth.inverse_shape
    shape = np.linalg.inv(np.stack([np.stack([a, c], axis=-1), np.stack([b, d], axis=-1)], axis=-2))
    first, second = shape[..., 0], shape[..., 1]
    along = np.full((len(x), len(x)), np.inf)
    np.fill_diagonal(along, 0.0)
    for start, end, edge in ((0, 1, first), (1, 2, second - first), (0, 2, second)):
        i, j, length = cloth.faces[:, start], cloth.faces[:, end], np.linalg.norm(edge, axis=1)
        along[i, j] = along[j, i] = length
    beside = np.isfinite(along)
    for middle in range(len(x)):
        along = np.minimum(along, along[:, middle, None] + along[None, middle])
    apart = np.linalg.norm(x[:, None] - x[None], axis=2)
    same = beside | (along <= NEAR_M) | (apart >= FOLDED * along)
    found = np.where(same | ~(apart < reach), np.inf, apart)
    return np.minimum(found.min(axis=1), reach), np.where(np.isfinite(found.min(axis=1)), found.argmin(axis=1), -1)


class Around(NamedTuple):
    """What acts on vertices from outside: their ``own`` part of the body and the rest, and the planes of other parts,
    ``point`` and ``normal`` (V, 3), whose springs ``n_per_m`` (V,) are zero where there is none; what holds gives
    ``slack`` [m] (V,). Against ``friction`` vertices leave where they were ``stuck`` [m] (V, 3)."""

    own: Outside
    point: np.ndarray
    normal: np.ndarray
    n_per_m: np.ndarray
    slack: np.ndarray
    stuck: np.ndarray
    friction: float


def touching(made: Problem, dressed: WornCloth, x: np.ndarray, skin: np.ndarray, touched: TouchedSamples) -> Around:
    """The planes of the own part of the body and of others."""
    point, normal = planes(x, skin, dressed, np.maximum(touched.other, 0))
    return Around(
        surroundings(made, *planes(x, skin, dressed, touched.own)),
        *(point, normal, np.where(touched.other >= 0, made.contact_n_per_m, 0.0)),
        np.full(len(x), made.constants.slack),
        *(x, 0.0),
    )


def kept_apart(x: np.ndarray, around: Around, made: Problem, cloth: ClothMesh) -> Around:
    """``around`` with the planes that keep ``x`` [m] (V, 3) apart where these are nearer than other parts'."""
    edge_m = 1.0 / float(made.constants.per_edge)
    _, nearest = room(x, cloth, min(SPACING * edge_m, ROOM_M))
    there, kept_m = x.copy(), min(KEPT * edge_m, KEPT_M)
    for v in np.flatnonzero(nearest >= 0):
        (there[v],) = closest_point(x[v, None], x, cloth.faces[(cloth.faces == nearest[v]).any(axis=1)]).point
    room_m = np.linalg.norm(x - there, axis=1)
    height = 0.5 * (room_m - kept_m) + made.constants.gap
    over = np.where(around.n_per_m > 0.0, ((x - around.point) * around.normal).sum(axis=1), np.inf)
    taken = (room_m > 0.0) & (room_m < kept_m) & (height <= over)
    normal = (x - there) / np.where(room_m > 0.0, room_m, 1.0)[:, None]
    return around._replace(
        point=np.where(taken[:, None], x - height[:, None] * normal, around.point),
        normal=np.where(taken[:, None], normal, around.normal),
        n_per_m=np.where(taken, made.contact_n_per_m, around.n_per_m),
    )


def whole_step(dressed: WornCloth, made: Problem, around: Around, x: np.ndarray) -> np.ndarray:
    """The way [m] (V, 3) that the whole cloth takes at ``x``."""
    known = dressed.band_n_per_m + HOLD * made.contact_n_per_m
    return solved_step(dressed, gradient_known(x, made, around, known))


def solved_step(dressed: WornCloth, gradient: np.ndarray) -> np.ndarray:
    """What the whole cloth answers [m] (V, 3) to a ``gradient`` [N], by a dense matrix."""
    step = -np.linalg.solve(stiffness(dressed.cloth, dressed.material, dressed.springs_n_per_m).toarray(), gradient)
    return step * (CLAMP_M / max(float(np.linalg.norm(step, axis=1).max()), CLAMP_M))


def sweep(x: np.ndarray, made: Problem, around: Around) -> np.ndarray:
    """One sweep of vertex block descent from ``x`` [m] (V, 3), bending by the quadratic matrix and at creases."""
    moved, bend = x.copy(), made.quadratic
    for v in made.order:
        gradient, block = reference.vertex_block(v, moved, _with_slack(made, around.slack[v]), around.own)
        (push,), (stiffness,) = _pushed(moved, made, around, slice(v, v + 1))
        (rub,), (grip,) = rubbed(moved, made, around, slice(v, v + 1))
        push, block = push + rub, block + grip
        block = block + stiffness + bend.diagonal[v] * np.eye(3)
        step = -np.linalg.solve(block, gradient + push + _bending(moved, made, v))
        moved[v] += _limited(step, float(made.constants.reach))
    return moved


def energy(x: np.ndarray, made: Problem, around: Around) -> float:
    """Energy [J] at ``x`` [m] (V, 3), where all hinges of ``made`` bend by their angle."""
    depth = np.maximum(made.constants.gap - ((x - around.point) * around.normal).sum(axis=1), 0.0)
    found, _ = reference.energy_and_gradient(x, _with_slack(made, around.slack), around.own)
    return found + 0.5 * float((around.n_per_m * depth**2).sum())


def lifted(x: np.ndarray, around: Around, clearance_m: float) -> np.ndarray:
    """``x`` [m] (V, 3) above its planes: a share of what it lacks to ``clearance_m`` over those of other parts, then
    all of what it lacks over its own, where that is not too deep."""
    there = (around.n_per_m > 0.0)[:, None]
    for point, normal, share in (
        (around.point, around.normal, OTHER * there),
        (around.own.point, around.own.normal, 1.0),
    ):
        low_m = np.maximum(clearance_m - ((x - point) * normal).sum(axis=1, keepdims=True), 0.0)
        left = np.clip((TOO_DEEP_M - low_m) / (TOO_DEEP_M - DEEP_M), 0.0, 1.0)
        x = x + share * left * low_m * normal
    return x


def limited(x: np.ndarray, cloth: ClothMesh) -> np.ndarray:
    """``x`` [m] (V, 3) after passes in which vertices go half of what each triangle's edges are too long or short."""
    first, then = cloth.faces.reshape(-1), np.roll(cloth.faces, -1, axis=1).reshape(-1)
    rest = rest_lengths(cloth).reshape(-1)
    for _ in range(LIMIT_PASSES):
        edge, way, count = x[then] - x[first], np.zeros_like(x), np.zeros(len(x))
        length = np.linalg.norm(edge, axis=1)
        share = 0.5 - 0.5 * np.clip(length, SHORTEST * rest, LONGEST * rest) / length
        for vertex, sign in ((first, 1.0), (then, -1.0)):
            np.add.at(way, vertex, sign * share[:, None] * edge)
            np.add.at(count, vertex, share != 0.0)
        x = x + way / np.maximum(count, 1.0)[:, None]
    return x


def _pushed(x: np.ndarray, made: Problem, around: Around, which: slice) -> tuple[np.ndarray, np.ndarray]:
    """Gradient [N] (n, 3) and Hessian [N/m] (n, 3, 3) of the contact of the vertices ``which`` with other parts."""
    n, n_per_m = around.normal[which], around.n_per_m[which]
    depth = np.maximum(made.constants.gap - ((x[which] - around.point[which]) * n).sum(axis=1), 0.0)
    block = (n_per_m * (depth > 0.0))[:, None, None] * n[:, :, None] * n[:, None, :]
    return -(n_per_m * depth)[:, None] * n, block


def rubbed(x: np.ndarray, made: Problem, around: Around, which: slice) -> tuple[np.ndarray, np.ndarray]:
    """Coulomb friction of the vertices ``which`` with their own part of the body [N] (n, 3), as a gradient, and what
    stands for its Hessian [N/m] (n, 3, 3): ``friction`` times the force of contact, less in a shorter way than
    ``SLIP_M``, along the tangent plane."""
    n, stiff = around.own.normal[which], made.contact_n_per_m[which]
    press_n = stiff * np.maximum(made.constants.gap - ((x[which] - around.own.point[which]) * n).sum(axis=1), 0.0)
    slip = x[which] - around.stuck[which]
    slip -= (slip * n).sum(axis=1, keepdims=True) * n
    grip = around.friction * press_n / np.maximum(np.linalg.norm(slip, axis=1), SLIP_M)
    return grip[:, None] * slip, grip[:, None, None] * (np.eye(3) - n[:, :, None] * n[:, None, :])


def stuck_places(grip: np.ndarray, skin: np.ndarray, graph: SkinGraph, own: np.ndarray) -> np.ndarray:
    """Where the posed ``skin`` has taken what lies ``grip`` [m] (V, 3) in the frames of its samples ``own`` (V,)."""
    return skin[own, :3] + _to_world(_skin_frames(skin, graph, own), grip)


def write_grip(x: np.ndarray, stuck: np.ndarray, skin: np.ndarray, graph: SkinGraph, own: np.ndarray) -> np.ndarray:
    """How what was ``stuck`` lies in the frames of the samples ``own`` (V,), having come after ``x`` [m] (V, 3)."""
    frames = _skin_frames(skin, graph, own)
    slip = _to_local(frames, x - stuck) * [0.0, 1.0, 1.0]
    slip *= SLIP_M / np.maximum(np.linalg.norm(slip, axis=1, keepdims=True), SLIP_M)
    return _to_local(frames, x - skin[own, :3]) - slip


def _skin_frames(skin: np.ndarray, graph: SkinGraph, own: np.ndarray) -> np.ndarray:
    """Rows: a sample's normal, the way to its first neighbour laid into the plane, and their product."""
    normal = skin[own, 4:7].astype(np.float64)
    edge = skin[graph.neighbour[own, 0], :3] - skin[own, :3].astype(np.float64)
    edge -= (edge * normal).sum(axis=1, keepdims=True) * normal
    length = np.linalg.norm(edge, axis=1, keepdims=True)
    edge = edge / np.where(length > 0.0, length, 1.0)
    return np.stack([normal, edge, np.cross(normal, edge)], axis=1)


def gradient_known(x: np.ndarray, made: Problem, around: Around, known_n_per_m: np.ndarray) -> np.ndarray:
    """The gradient [N] (V, 3) that steps of the whole take: leash and friction together are no stiffer than
    ``known_n_per_m`` (V,), two planes no stiffer than one."""
    rub, grip = rubbed(x, made, around, slice(None))
    held, contact = around.own.band_n_per_m, made.contact_n_per_m
    held_now = held * (np.linalg.norm(x - around.own.band, axis=1) > around.slack)
    less = known_n_per_m / np.maximum(held_now + 0.5 * np.trace(grip, axis1=1, axis2=2), known_n_per_m)
    closed = contact * (made.constants.gap > ((x - around.own.point) * around.own.normal).sum(axis=1))
    closed = closed + around.n_per_m * (made.constants.gap > ((x - around.point) * around.normal).sum(axis=1))
    share = contact / np.maximum(closed, contact)
    made = replace(made, contact_n_per_m=share * contact)
    own = replace(around.own, band_n_per_m=less * held)
    around = around._replace(own=own, n_per_m=share * around.n_per_m)
    _, gradient = reference.energy_and_gradient(x, _with_slack(made, around.slack), around.own)
    gradient += _pushed(x, made, around, slice(None))[0] + less[:, None] * rub
    return gradient + np.stack([_bending(x, made, v) for v in range(len(x))])


def _with_slack(made: Problem, slack: np.ndarray) -> Problem:
    return replace(made, constants=made.constants._replace(slack=slack))


def _bending(x: np.ndarray, made: Problem, v: int) -> np.ndarray:
    """Row v of the quadratic bending's matrix times ``x``."""
    entries = slice(made.quadratic.start[v], made.quadratic.start[v + 1])
    return made.quadratic.value[entries] @ x[made.quadratic.vertex[entries]] + made.quadratic.diagonal[v] * x[v]


def _limited(way: np.ndarray, reach: float) -> np.ndarray:
    return way * (reach / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), reach))


def _to_world(frames: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.einsum("vji,vj->vi", frames, vectors)


def _to_local(frames: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.einsum("vji,vi->vj", frames, vectors)
