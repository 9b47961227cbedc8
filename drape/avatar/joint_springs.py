"""A garment's own joints as spring bones of VRM, for motion that nobody draped: their constants, fitted to draped
frames.

Each joint turns about its pivot; its tail lies in the middle of its cloth or beyond. Of many constants those are taken
with which the cloth, moved by the law of ``drape.motion.spring_bones``, comes nearest to the draped one and sinks least
into the legs, which are capsules. A joint is a spring only where that is better than its cloth moved by the rig alone,
and in no clip much worse. Otherwise the rig gets its weights.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drape.avatar.affine_maps import affine_inverse, compose
from drape.avatar.distilled import Distilled, DrapedClip, pelvis_places
from drape.avatar.rig_motion import RigMotion
from drape.avatar.rig_weights import HEAVIEST
from drape.avatar.skin_decomposition import blend_vertices, farthest_points
from drape.avatar.wearer import Wearer
from drape.body.skeleton import JOINT_NAMES
from drape.motion.spring_bones import Capsules, Springs, nearest_off, shortest_turns, tails

STIFFNESS = (0.05, 0.2, 0.8, 4.0)
GRAVITY = (0.0, 0.2, 0.8)
DRAG = (0.1, 0.4, 1.0)
BETTER, WORST = 0.97, 1.4  # A spring's error may be so large a share of the rig's, over all clips and in each.
SHORTEST_M = 0.05  # A spring is at least so long.
WIDEST_M = 0.03  # A tail's own radius is at most this.
POINTS = 6  # So many points of a joint's cloth should not sink into limbs.
SINKING = 100.0  # The cost of a squared depth in a limb, where the squared distance from the draped point costs 1.
LOOKED_AT = slice(None, None, 5)  # The cloth of every fifth frame counts.
LIMBS = tuple(
    (f"{side}_{a}", f"{side}_{b}") for side in ("left", "right") for a, b in (("hip", "knee"), ("knee", "ankle"))
)


@dataclass(frozen=True, eq=False)
class Limb:
    """A capsule that moves with ``node`` of the skeleton. Its axis goes from ``start`` (3,) to ``end`` (3,) in the
    node's frame; these and ``radius`` are in the unit of the file."""

    node: int
    start: np.ndarray
    end: np.ndarray
    radius: float


@dataclass(frozen=True, eq=False)
class JointSprings:
    """The E own joints of a ``distilled`` garment as springs: the constants ``numbers`` of the springs, and their
    ``tails`` (E, 3) in the bind pose.

    ``limbs`` are C capsules, and ``felt`` (E, C) bool says which of them each spring feels. Lengths are in the unit of
    the file.
    """

    distilled: Distilled
    tails: np.ndarray
    numbers: Springs
    limbs: tuple[Limb, ...]
    felt: np.ndarray

    def moves(self, motion: RigMotion) -> np.ndarray:
        """Returns the motions (F, E, 3, 4) of the E joints while they swing as in a VRM player, at rest in the first of
        the F frames of ``motion``: maps of points from the bind pose to the frame of the pelvis, in the unit of the
        file."""
        at, heads, rest = _carried(self.distilled, self.tails, motion)
        found = tails(self.numbers, heads, rest, motion.fps, _capsules(self.limbs, self.felt, motion))
        swung = _swung(at, heads, shortest_turns(heads, rest, found))
        return compose(affine_inverse(pelvis_places(motion))[:, None], swung)


def _swung(at: np.ndarray, heads: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Motions (..., E, 3, 4) of joints that are ``at`` (..., E, 3, 4), turned by ``turns`` about their ``heads``."""
    return compose(np.concatenate([turns, heads[..., None] - turns @ heads[..., None]], axis=-1), at)


def fit_springs(distilled: Distilled, clips: Sequence[DrapedClip], wearer: Wearer) -> JointSprings:
    """Returns springs for those own joints of ``distilled`` whose cloth comes nearer to ``clips`` on springs than on
    the rig alone; the rig moves the cloth of the others. Their constants bring the cloth nearest to ``clips`` and let
    it sink least into the legs of ``wearer``. A clip is run from its first to its last frame."""
    unit, skeleton = wearer.scale, clips[0].motion
    ends, limbs = _tails(distilled, unit), leg_capsules(wearer, skeleton)
    _, _, rest = _carried(distilled, ends, skeleton, rows=slice(0, 1))
    hips = min(_limb_line(limb, skeleton.world[0, limb.node])[0][1] for limb in limbs[::2])
    felt = np.repeat(rest[0, :, 1:2] < hips, len(limbs), axis=1)
    seen = list(map(_looked_at, clips))
    tracks = [compose(pelvis_places(few.motion)[:, None], distilled.fitted(few, unit)) for few in seen]
    room = _room([_moved(track, ends) for track in tracks], limbs, seen)
    felt &= room[:, None] > 0.0  # Cloth that lies on a limb goes with it, and feels none.
    radius = np.where(felt.any(axis=1), np.clip(room, 0.0, WIDEST_M / unit), 0.0)
    stiffness, gravity, drag = np.array(list(itertools.product(STIFFNESS, GRAVITY, DRAG))).T[..., None]
    costs, on_rig = np.zeros((len(clips), len(drag), distilled.count)), np.zeros((len(clips), distilled.count))
    for number, (clip, few, track) in enumerate(zip(clips, seen, tracks, strict=True)):
        at, heads, still = _carried(distilled, ends, clip.motion)
        capsules = _capsules(limbs, felt, clip.motion)
        cloth = _Cloth.of(distilled, few, track, _capsules(limbs, felt, few.motion), unit)
        found = tails(Springs(stiffness, gravity, drag, radius), heads, still, clip.motion.fps, capsules)
        head, stiff, swung = (rows[LOOKED_AT] for rows in (heads[:, None], still[:, None], found))
        costs[number] = cloth.cost(_swung(at[LOOKED_AT, None], head, shortest_turns(head, stiff, swung)))
        on_rig[number] = cloth.cost_on_rig()
    best = costs.sum(axis=0).argmin(axis=0)
    least = costs[:, best, np.arange(len(best))]
    # Better in one clip and much worse in the next is luck, which motion that nobody saw does not have.
    sprung = (least.sum(axis=0) < BETTER**2 * on_rig.sum(axis=0)) & (least < WORST**2 * on_rig).all(axis=0)
    best = best[sprung]
    numbers = Springs(stiffness[best, 0], gravity[best, 0], drag[best, 0], radius[sprung])
    return JointSprings(_only(distilled, sprung), ends[sprung], numbers, limbs, felt[sprung])


def _looked_at(clip: DrapedClip) -> DrapedClip:
    """The frames of ``clip`` whose cloth counts."""
    rows = np.arange(len(clip.vertices))[LOOKED_AT]
    return DrapedClip(clip.vertices[rows], clip.motion.part(rows))


def _only(distilled: Distilled, kept: np.ndarray) -> Distilled:
    """``distilled`` with those of its joints that are ``kept`` (E,); the rig moves the cloth of the others."""
    own = distilled.weights[:, len(distilled.joints) :]
    left = own[:, ~kept].sum(axis=1, keepdims=True)
    weights = np.pad(distilled.weights[:, : len(distilled.joints)] + left * distilled.on_rig, ((0, 0), (0, kept.sum())))
    weights[:, len(distilled.joints) :] = own[:, kept]
    most = np.sort(weights, axis=1)[:, -min(HEAVIEST, weights.shape[1]), None]
    weights = np.where(weights >= most, weights, 0.0)
    return replace(
        distilled, weights=weights / weights.sum(axis=1, keepdims=True), parents=distilled.parents[kept],
        pivots=distilled.pivots[kept], still=distilled.still[kept],
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Cloth:
    """Vertices ``rest`` (E, K, 3) of the cloth of each joint over a clip: where they are ``draped`` (F, E, K, 3), the
    ``shares`` (E, K) of the joint in them, what all ``others`` add to that (F, E, K, 3), and where they were if the rig
    alone moved them, ``on_rig`` (F, E, K, 3). ``legs``: what they should not sink into."""

    rest: np.ndarray
    draped: np.ndarray
    shares: np.ndarray
    others: np.ndarray
    on_rig: np.ndarray
    legs: Capsules

    @classmethod
    def of(cls, distilled: Distilled, clip: DrapedClip, track: np.ndarray, legs: Capsules, unit: float) -> _Cloth:
        own = distilled.weights[:, len(distilled.joints) :].T
        rows = np.stack([_some(distilled.rest, share) for share in own])
        rest, shares = distilled.rest[rows], np.take_along_axis(own, rows, axis=1)
        draped = clip.vertices[:, rows] / unit
        rig = compose(clip.motion.world[1:, distilled.joints, :3, :], distilled.binds)
        on_rig = blend_vertices(distilled.on_rig[rows.reshape(-1)], rest.reshape(-1, 3), rig).reshape(draped.shape)
        others = draped - shares[..., None] * _placed(track, rest)
        return cls(rest, draped, shares, others, on_rig, legs)

    def cost(self, moves: np.ndarray) -> np.ndarray:
        """What it costs (N, E) that the joints are at ``moves`` (F, N, E, 3, 4)."""
        return self._off(_placed(moves, self.rest))

    def cost_on_rig(self) -> np.ndarray:
        """What it costs (E,) that the rig moves the cloth of a joint."""
        return self._off(self.on_rig[:, None])[0]

    def _off(self, own: np.ndarray) -> np.ndarray:
        at, draped = self.others[:, None] + self.shares[..., None] * own, self.draped[:, None]
        deep = sink_depths(at, draped, self.legs)
        return (((at - draped) ** 2).sum(axis=-1) + SINKING * deep**2).mean(axis=-1).sum(axis=0)


def sink_depths(at: np.ndarray, draped: np.ndarray, limbs: Capsules) -> np.ndarray:
    """Returns how much deeper (F, ..., E, K) points ``at`` (F, ..., E, K, 3) lie in one of ``limbs`` than the points
    ``draped`` (F, ..., E, K, 3), in their unit: the most of all limbs, 0 where they lie no deeper."""
    most = np.zeros(at.shape[:-1])
    for one, radius in enumerate(limbs.radii):
        start, end = (ends[:, one].reshape(-1, *(1,) * (at.ndim - 2), 3) for ends in (limbs.starts, limbs.ends))
        allowed = np.minimum(nearest_off(draped, start, end)[1], radius)
        most = np.maximum(most, allowed - nearest_off(at, start, end)[1])
    return most


def leg_capsules(wearer: Wearer, motion: RigMotion) -> tuple[Limb, ...]:
    """Returns capsules of the thighs and shins of ``wearer``, the left leg's first. The radius is the median distance
    of the bare body's skin from the bone. Frame 0 of ``motion`` is the T-pose in which they are measured."""
    joints, capsules = wearer.body.joints_template, []
    strongest = wearer.body.weights.argmax(axis=1)
    for top, end in LIMBS:
        a, b = joints[[JOINT_NAMES.index(top), JOINT_NAMES.index(end)]]
        skin = wearer.body.v_template[strongest == JOINT_NAMES.index(top)]
        radius = float(np.median(nearest_off(skin, a, b)[1])) if len(skin) else 0.05
        node = wearer.rig.sources[top]
        local = np.linalg.inv(motion.world[0, node])
        start, stop = (local[:3, :3] @ (joint / wearer.scale) + local[:3, 3] for joint in (a, b))
        capsules.append(Limb(node, start, stop, radius / wearer.scale))
    return tuple(capsules)


def _tails(distilled: Distilled, unit: float) -> np.ndarray:
    """The tails (E, 3) in the bind pose: from the pivot through the middle of the cloth that a joint moves."""
    own = distilled.weights[:, distilled.weights.shape[1] - distilled.count :]
    middles = (own.T @ distilled.rest) / np.maximum(own.sum(axis=0), 1e-12)[:, None]
    way = middles - distilled.pivots
    length = np.linalg.norm(way, axis=1, keepdims=True)
    way = np.where(length > 1e-6, way / np.maximum(length, 1e-12), [0.0, -1.0, 0.0])
    return distilled.pivots + way * np.maximum(length, SHORTEST_M / unit)


def _carried(
    distilled: Distilled, ends: np.ndarray, motion: RigMotion, *, rows: slice = slice(1, None)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Motions (F, E, 3, 4) of stiff joints in the world, and their heads and tails (F, E, 3)."""
    above = compose(motion.world[rows, distilled.joints, :3, :], distilled.binds)
    at = compose(above[:, distilled.parents], distilled.still)
    return at, _moved(at, distilled.pivots), _moved(at, ends)


def _moved(at: np.ndarray, points: np.ndarray) -> np.ndarray:
    """``points`` (E, 3), each by its own motion of ``at`` (F, E, 3, 4)."""
    return _placed(at, points[:, None])[..., 0, :]


def _placed(at: np.ndarray, points: np.ndarray) -> np.ndarray:
    """``points`` (E, K, 3), each by the motion of its joint, ``at`` (..., E, 3, 4)."""
    return np.einsum("...eab,ekb->...eka", at[..., :3], points) + at[..., None, :, 3]


def _some(rest: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Vertices (``POINTS``,) of ``rest`` (V, 3), far from each other, in which a joint has much ``share`` (V,)."""
    rows = np.flatnonzero(share >= 0.5 * share.max())
    return np.resize(rows[farthest_points(rest[rows], min(POINTS, len(rows)))], POINTS)


def _room(aims: Sequence[np.ndarray], limbs: Sequence[Limb], clips: Sequence[DrapedClip]) -> np.ndarray:
    """How near the tails (E,) come to a limb by the tracks, one time in twenty; below zero inside."""
    room = []
    for aim, one in zip(aims, clips, strict=True):
        lines = [_limb_line(limb, one.motion.world[1:, limb.node][:, None]) for limb in limbs]
        offs = [nearest_off(aim, a, b)[1] - limb.radius for limb, (a, b) in zip(limbs, lines, strict=True)]
        room.append(np.min(offs, axis=0))
    return np.quantile(np.concatenate(room), 0.05, axis=0)


def _limb_line(limb: Limb, world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both ends (..., 3) of the axis of ``limb`` whose node is at ``world`` (..., 4, 4)."""
    start, end = (world[..., :3, :3] @ point + world[..., :3, 3] for point in (limb.start, limb.end))
    return start, end


def _capsules(limbs: Sequence[Limb], felt: np.ndarray, motion: RigMotion) -> Capsules:
    """The ``limbs`` in the frames of ``motion``."""
    lines = [_limb_line(limb, motion.world[1:, limb.node]) for limb in limbs]
    starts, ends = (np.stack([line[side] for line in lines], axis=1) for side in (0, 1))
    return Capsules(starts, ends, np.array([limb.radius for limb in limbs]), felt)
