"""Joints of a garment as spring bones of VRM, for motion that nobody draped: their numbers, fitted to frames.

Each joint turns about its pivot; its tail is where the middle of its cloth is, or beyond. The numbers of a spring are
those of many with which its tail, by the law of ``drape.motion.spring_bones``, comes nearest to where tracks put it.
A joint that does no better than if it only followed the rig is none, unless its cloth stands off the legs, which are
capsules.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drape.avatar.affine_maps import affine_inverse, compose
from drape.avatar.distilled import Distilled, DrapedClip, pelvis_places
from drape.avatar.rig_motion import RigMotion
from drape.avatar.wearer import Wearer
from drape.body.skeleton import JOINT_NAMES
from drape.motion.spring_bones import Capsules, Springs, nearest_off, shortest_turns, tails

STIFFNESS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 4.0)
GRAVITY = (0.0, 0.1, 0.2, 0.4, 0.8)
DRAG = (0.1, 0.4, 0.7, 1.0)
BETTER = 0.97  # of a joint's error without a spring
SHORTEST_M = 0.05  # of a spring
WIDEST_M = 0.03  # of a tail's own radius
STANDS_OFF_M = 0.01  # from the limbs: such cloth is sprung in any case, so that limbs push it
LIMBS = tuple(
    (f"{side}_{a}", f"{side}_{b}") for side in ("left", "right") for a, b in (("hip", "knee"), ("knee", "ankle"))
)


@dataclass(frozen=True, eq=False)
class Limb:
    """A capsule on ``node`` of the skeleton, from ``start`` (3,) to ``end`` (3,) in the node's frame."""

    node: int
    start: np.ndarray
    end: np.ndarray
    radius: float


@dataclass(frozen=True, eq=False)
class JointSprings:
    """Joints of a ``distilled`` garment as springs: the ``numbers`` (E,) of each spring, the ``tails`` (E, 3) in the
    bind pose, and which joints are ``sprung`` (E,).

    ``limbs`` are the capsules, and ``felt`` (E, C) says which of them each spring feels. ``unit``: metres per unit of
    the file.
    """

    distilled: Distilled
    tails: np.ndarray
    sprung: np.ndarray
    numbers: Springs
    limbs: tuple[Limb, ...]
    felt: np.ndarray

    def moves(self, motion: RigMotion) -> np.ndarray:
        """The motions (F, E, 3, 4) of the joints as players move them, seen from the pelvis."""
        at, heads, rest = _carried(self.distilled, self.tails, motion)
        found = tails(self.numbers, heads, rest, motion.fps, _capsules(self.limbs, self.felt, motion))
        turn = shortest_turns(heads, rest, np.where(self.sprung[:, None], found, rest))
        swung = compose(np.concatenate([turn, heads[..., None] - turn @ heads[..., None]], axis=-1), at)
        return compose(affine_inverse(pelvis_places(motion))[:, None], swung)


def fit_springs(distilled: Distilled, clips: Sequence[DrapedClip], wearer: Wearer) -> JointSprings:
    """Returns the springs of ``distilled`` whose tails come nearest to those of ``clips``. A clip is run from its first
    to its last frame."""
    unit, skeleton = wearer.scale, clips[0].motion
    ends, limbs = _tails(distilled, unit), leg_capsules(wearer, skeleton)
    _, _, rest = _carried(distilled, ends, skeleton, rows=slice(0, 1))
    hips = min(_limb_line(limb, skeleton.world[0, limb.node])[0][1] for limb in limbs[::2])
    felt = np.repeat(rest[0, :, 1:2] < hips, len(limbs), axis=1)
    aims = [_aims(distilled, ends, clip, unit) for clip in clips]
    room = _room(aims, limbs, clips)
    felt &= room[:, None] > 0.0  # cloth that lies on a limb goes with it
    radius = np.where(felt.any(axis=1), np.clip(room, 0.0, WIDEST_M / unit), 0.0)
    stiffness, gravity, drag = np.array(list(itertools.product(STIFFNESS, GRAVITY, DRAG))).T[..., None]
    costs, stiff = np.zeros((len(drag), distilled.count)), np.zeros(distilled.count)
    for clip, aim in zip(clips, aims, strict=True):
        _, heads, still = _carried(distilled, ends, clip.motion)
        capsules = _capsules(limbs, felt, clip.motion)
        for start in range(0, len(drag), 60):
            part = slice(start, start + 60)
            numbers = Springs(stiffness[part], gravity[part], drag[part], radius)
            found = tails(numbers, heads, still, clip.motion.fps, capsules)
            costs[part] += ((found - aim[:, None]) ** 2).sum(axis=(0, 3))
        stiff += ((still - aim) ** 2).sum(axis=(0, 2))
    best = costs.argmin(axis=0)
    sprung = (costs.min(axis=0) < BETTER**2 * stiff) | (radius * unit > STANDS_OFF_M)
    numbers = Springs(stiffness[best, 0], gravity[best, 0], drag[best, 0], radius)
    return JointSprings(distilled, ends, sprung, numbers, limbs, felt)


def leg_capsules(wearer: Wearer, motion: RigMotion) -> tuple[Limb, ...]:
    """Thighs and shanks of ``wearer``, as wide as half of its skin there."""
    joints, capsules = wearer.body.joints_template, []
    strongest = wearer.weights.argmax(axis=1)
    for top, end in LIMBS:
        a, b = (joints[JOINT_NAMES.index(one)] for one in (top, end))
        skin = wearer.vertices[strongest == JOINT_NAMES.index(top)].astype(np.float64)
        radius = float(np.median(nearest_off(skin, a, b)[1])) if len(skin) else 0.05
        node = wearer.rig.sources[top]
        local = np.linalg.inv(motion.world[0, node])
        start, stop = (local[:3, :3] @ (one / wearer.scale) + local[:3, 3] for one in (a, b))
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
    return np.einsum("feab,eb->fea", at[..., :3], points) + at[..., 3]


def _aims(distilled: Distilled, ends: np.ndarray, draped: DrapedClip, unit: float) -> np.ndarray:
    """Where the tails (F, E, 3) are in the world by the tracks of what was ``draped``."""
    seen = distilled.fitted(draped, unit)
    return _moved(compose(pelvis_places(draped.motion)[:, None], seen), ends)


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
