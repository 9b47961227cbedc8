"""A skirt on chains of spring bones, as avatars come with: what players show of it, by the law of VRM.

Twelve chains of three joints go down round the skirt, with the numbers that UniVRM's component has by default
(stiffness 1, no gravity, drag 0.4, radius 0.02 m) and a capsule on each thigh and shank, as thick as the leg. Above the
chains the cloth moves with the body.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.avatar.joint_springs import LIMBS
from drape.body.skeleton import JOINT_NAMES
from drape.motion.spring_bones import Springs, nearest_off, on_sphere, pushed_out, step, turned

CHAINS, LEVELS = 12, 3
DEFAULTS = Springs(np.array(1.0), np.array(0.0), np.array(0.4), np.array(0.02))
ABOVE_HIPS_M = 0.03  # where the chains begin, over the joints of the hips
PELVIS = JOINT_NAMES.index("pelvis")


class Legs(NamedTuple):
    """Capsules of thighs and shanks: the bones that move them (4,), both ends at rest [m] (4, 3), radii [m] (4,)."""

    bones: np.ndarray
    starts: np.ndarray
    ends: np.ndarray
    radii: np.ndarray


def legs_of(skin: np.ndarray, weights: np.ndarray, joints: np.ndarray) -> Legs:
    """The legs of a ``skin`` [m] (V, 3) with ``weights`` (V, 24) on ``joints`` [m] (24, 3)."""
    numbers = np.array([[JOINT_NAMES.index(name) for name in pair] for pair in LIMBS])
    starts, ends = joints[numbers[:, 0]], joints[numbers[:, 1]]
    strongest = weights.argmax(axis=1)
    radii = [
        np.median(nearest_off(skin[strongest == bone], start, end)[1])
        for bone, start, end in zip(numbers[:, 0], starts, ends, strict=True)
    ]
    return Legs(numbers[:, 0], starts, ends, np.array(radii))


class SkirtSprings:
    """The chains of a skirt at ``rest`` [m] (V, 3) on a body whose ``joints`` [m] (24, 3) are in T-pose.

    ``places`` (L + 1, C, 3): the joints of the chains, then their ends. ``share`` (V, L, C): how much each joint moves
    a vertex; what is left of one moves with the body.
    """

    def __init__(self, rest: np.ndarray, joints: np.ndarray) -> None:
        middle, hips = joints[PELVIS], [joints[JOINT_NAMES.index(f"{side}_hip"), 1] for side in ("left", "right")]
        top, hem = float(np.mean(hips)) + ABOVE_HIPS_M, float(rest[:, 1].min())
        around = np.arctan2(rest[:, 0] - middle[0], rest[:, 2] - middle[2]) % (2 * np.pi) / (2 * np.pi) * CHAINS
        down = np.clip((top - rest[:, 1]) / (top - hem), 0.0, 1.0) * LEVELS
        self.rest, self.places = rest, np.zeros((LEVELS + 1, CHAINS, 3))
        for level, chain in np.ndindex(LEVELS + 1, CHAINS):
            off = np.hypot((around - chain + CHAINS / 2) % CHAINS - CHAINS / 2, down - level)
            near = np.argsort(off)[:8]
            self.places[level, chain] = rest[near].mean(axis=0)
        chains = np.maximum(0.0, 1.0 - np.abs((around[:, None] - np.arange(CHAINS) + CHAINS / 2) % CHAINS - CHAINS / 2))
        at = np.maximum(down - 0.5, 0.0)  # the middle of a bone moves with it alone
        levels = np.maximum(0.0, 1.0 - np.abs(np.minimum(at, LEVELS - 1)[:, None] - np.arange(LEVELS)))
        levels[:, 0] *= np.clip(2.0 * down, 0.0, 1.0)
        self.share = levels[:, :, None] * chains[:, None, :]

    def over(self, carried: np.ndarray, rotations: np.ndarray, places: np.ndarray, legs: Legs, fps: float):
        """The skirt [m] (F, V, 3) in frames in which the body would carry it to ``carried`` (F, V, 3); ``rotations``
        (F, 24, 3, 3) and ``places`` (F, 24, 3) are those of the bones from the T-pose."""
        shares = self.share.reshape(len(self.rest), -1)
        found, now, before = [], None, None
        for frame, still in enumerate(carried):
            turn, move = rotations[frame, PELVIS], places[frame, PELVIS]
            ends = [np.einsum("cab,cb->ca", rotations[frame, legs.bones], one) + places[frame, legs.bones]
                    for one in (legs.starts, legs.ends)]  # fmt: skip
            tails = self.places[1:] @ turn.T + move
            now, before = (tails, tails) if now is None else (now, before)
            after, turns = self._step(now, before, turn, self.places[0] @ turn.T + move, ends, legs, 1.0 / fps)
            now, before = after, now
            heads = np.concatenate([(self.places[0] @ turn.T + move)[None], after[:-1]])
            moves = heads - np.einsum("lcab,lcb->lca", turns, self.places[:-1])
            linear = np.einsum("vj,jab->vab", shares, turns.reshape(-1, 3, 3))
            swung = np.einsum("vab,vb->va", linear, self.rest) + shares @ moves.reshape(-1, 3)
            found.append(swung + (1.0 - shares.sum(axis=1))[:, None] * still)
        return np.stack(found)

    def _step(self, now, before, turn, head, ends, legs: Legs, step_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Tails (L, C, 3) after a step, and the turns (L, C, 3, 3) of the joints from the T-pose."""
        above, tails, turns = np.broadcast_to(turn, (CHAINS, 3, 3)), [], []
        for level in range(LEVELS):
            way = self.places[level + 1] - self.places[level]
            rest = head + np.einsum("cab,cb->ca", above, way)
            tail = step(DEFAULTS, now[level], before[level], head, rest, step_s)
            for start, end, radius in zip(*ends, legs.radii, strict=True):
                tail = on_sphere(pushed_out(tail, start, end, radius + DEFAULTS.radius), head, rest)
            above = turned(head, rest, tail) @ above
            turns.append(above)
            tails.append(tail)
            head = tail
        return np.stack(tails), np.stack(turns)
