"""A person's joints by their positions, for rigs whose names are unknown.

The lowest skin shows the feet: two branches of one node end there. The skin farthest out to both sides shows the hands:
their branches leave the trunk at another node, and what goes on upwards from there is neck and head. Along each branch
the joints are the three nodes whose distances are the most like a person's (``LEG``, ``ARM``), so that bones of twist
and roll between them are passed over. Feet show where the character looks, and so which side is its left.

Only nodes that move skin count. Up is y, as glTF has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from drape.avatar.character import Character
from drape.errors import MotionError
from drape.motion.joint_names import CURE, ancestors, with_trunk

GROUND = 0.05  # Skin below this share of the height stands on the floor.
FEW = 0.02  # A node that moves a smaller share of that skin does not stand.
LOW_FOOT = 0.35  # The lowest node above all of a foot's nodes lies below this share of the height.
APART = 0.02  # Hips are at least this share of the height away from the middle.
LEG = (0.5, 0.1)  # The thigh's share of thigh and shin, and the ankle's height over the hip's.
# Shares of the arm down to its finger tips: where elbow and wrist lie. Then the upper arm's share of the arm without
# the hand, and the shoulder's distance from the middle as a share of the arm.
ARM = (0.35, 0.71, 0.5, 0.24)
HAND, HEAD = 0.15, 0.3  # What a node with fingers is worth, and the head's place between neck and crown.
LEAST_ARM = 0.25  # Arms are at least this share of the height; a child's are longer.
FINGER = 0.4  # A branch with a smaller share of the length of a hand's longest one is no finger.
LEAST_CONFIDENCE = 0.6


@dataclass(frozen=True)
class ShapeJoints:
    """The joints of a character by their positions: the node of each SMPL joint that was found, and how much the
    positions are like a person's, from 0 to 1."""

    sources: dict[str, int]
    confidence: float


def joints_by_shape(character: Character, *, label: str = "avatar") -> ShapeJoints:
    """Returns the joints of ``character`` by the positions of its nodes. Raises ``MotionError``, which says what is
    missing, for nodes that are no person's. ``label`` names the character there."""
    return _Reading(character, label).joints()


def hanging_on(parents: Sequence[int], node: int) -> np.ndarray:
    """Returns the mask (N,) bool of ``node`` and the nodes below it. ``parents`` (N,) come before their children, -1
    for none."""
    hangs = np.zeros(len(parents), dtype=bool)
    hangs[node] = True
    for other in range(node + 1, len(parents)):
        hangs[other] = parents[other] >= 0 and hangs[parents[other]]
    return hangs


class _Reading:
    """A character on the way to its joints: what each node moves, and whose branch it is in."""

    def __init__(self, character: Character, label: str) -> None:
        self.label, self.parents, self.places = label, character.parents, character.places
        self.skin = character.vertices
        # The node that moves each vertex most.
        self.owner = np.asarray(character.weights.argmax(axis=1)).reshape(-1)
        self.floor, self.height = float(self.skin[:, 1].min()), max(float(np.ptp(self.skin[:, 1])), 1e-9)
        moved = np.bincount(self.owner, minlength=len(self.parents))
        for node in range(len(self.parents) - 1, -1, -1):
            if self.parents[node] >= 0:
                moved[self.parents[node]] += moved[node]
        self.lives = moved > 0

    def joints(self) -> ShapeJoints:
        tops, feet = self._legs()
        legs = [self._leg(top, foot) for top, foot in zip(tops, feet, strict=True)]
        hips = self.places[[leg[0][0] for leg in legs]]
        across = (hips[0] - hips[1]) * [1.0, 0.0, 1.0]
        if np.linalg.norm(across) < 2.0 * APART * self.height:
            raise self._refused("hips beside each other", "two in one place")
        across = across / np.linalg.norm(across)
        middle, ahead = hips.mean(axis=0), self._ahead(legs, across)
        chest, arm_tops, tips = self._arms(across, middle, tops)
        if self.places[chest, 1] <= hips[:, 1].min():
            raise self._refused("arms above the legs", "arms at the hips")
        arms = [self._arm(top, tip, middle, across) for top, tip in zip(arm_tops, tips, strict=True)]
        # The arms are in the order of the legs, which lie along ``across``; up x ahead is the left.
        sides = ("left", "right") if np.cross([0.0, 1.0, 0.0], ahead) @ across > 0.0 else ("right", "left")
        joints: dict[str, int] = {}
        for side, (leg, _), (arm, _) in zip(sides, legs, arms, strict=True):
            joints |= {f"{side}_{name}": node for name, node in zip(("hip", "knee", "ankle"), leg, strict=True)}
            joints |= {f"{side}_{name}": node for name, node in zip(("shoulder", "elbow", "wrist"), arm, strict=True)}
            joints |= self._ends(side, leg[2], arm_tops[0 if side == sides[0] else 1], arm[0])
        joints = with_trunk(joints, self.parents, label=self.label) | self._head(chest, {*arm_tops, *tops})
        errors = [error for _, error in (*legs, *arms)]
        confidence = float(np.exp(-max(errors) - self._lopsided(joints, across, middle)))
        if confidence < LEAST_CONFIDENCE:
            raise self._refused("limbs of a person", f"limbs that are {100 * confidence:.0f} % like those")
        return ShapeJoints(joints, confidence)

    # --- the tree ---

    def _way(self, top: int, end: int) -> list[int]:
        """The nodes from ``top`` down to ``end``."""
        line = ancestors(self.parents, end)
        return line[: line.index(top) + 1][::-1]

    def _common(self, nodes: Sequence[int]) -> int:
        """The lowest node that holds all ``nodes``; -1 where they hang on several tops."""
        lines = [ancestors(self.parents, node) for node in nodes]
        return next((node for node in lines[0] if all(node in line for line in lines[1:])), -1)

    def _lengths(self, *nodes: int) -> list[float]:
        """How far each of ``nodes`` is from the next."""
        return np.linalg.norm(np.diff(self.places[list(nodes)], axis=0), axis=1).tolist()

    def _below(self, node: int) -> np.ndarray:
        """Which nodes (N,) are ``node`` or hang on it."""
        return hanging_on(self.parents, node)

    def _children(self, node: int) -> list[int]:
        return [other for other, parent in enumerate(self.parents) if parent == node and self.lives[other]]

    def _refused(self, expected: str, got: str) -> MotionError:
        return MotionError(
            f"{self.label}: skeleton",
            expected=f"a person's joints under a name that is known, or {expected}",
            got=f"other names, and by the places of the joints {got}",
            cure=CURE,
        )

    # --- legs ---

    def _legs(self) -> tuple[list[int], list[int]]:
        """The first node of each leg, and its last one that stands on the floor."""
        low = self.owner[self.skin[:, 1] < self.floor + GROUND * self.height]
        nodes, counts = np.unique(low, return_counts=True)
        standing = nodes[counts >= FEW * counts.sum()]
        fork = self._common(standing.tolist())
        if fork < 0:
            raise self._refused("one skeleton", "several")
        tops = [child for child in self._children(fork) if self._below(child)[standing].any()]
        feet = [[int(node) for node in standing if self._below(top)[node]] for top in tops]
        plain = [self.places[self._common(foot), 1] < self.floor + LOW_FOOT * self.height for foot in feet]
        if len(tops) != 2 or not all(plain):
            limbs = f"{len(tops)} limbs that do" if all(plain) else "limbs that part again above their feet"
            raise self._refused("two legs that stand on the floor", limbs)
        return tops, [max(foot, key=lambda node: len(ancestors(self.parents, node))) for foot in feet]

    def _leg(self, top: int, foot: int) -> tuple[tuple[int, int, int], float]:
        """Hip, knee and ankle on the way from ``top`` to ``foot``, and how unlike a person's they are."""
        way = self._way(top, foot)
        highest = self.places[way, 1].max()
        best, least = None, np.inf
        for hip, knee, ankle in combinations(way, 3):
            thigh, shin = self._lengths(hip, knee, ankle)
            over = self.places[hip, 1] - self.floor
            if min(thigh, shin, over) < 1e-6 * self.height:
                continue
            error = 2.0 * abs(thigh / (thigh + shin) - LEG[0])
            error += 2.0 * abs((self.places[ankle, 1] - self.floor) / over - LEG[1])
            error += 1.0 - float(np.linalg.norm(self.places[hip] - self.places[ankle])) / (thigh + shin)
            error += 2.0 * (highest - self.places[hip, 1]) / self.height
            error += 1.0 if self._in_line(hip) else 0.0
            if error < least:
                best, least = (hip, knee, ankle), error
        if best is None:
            raise self._refused("hip, knee and ankle in each leg", f"{len(way)} joints in one")
        return best, float(least)

    def _in_line(self, hip: int) -> bool:
        """Whether ``hip`` lies in the middle of the trunk: it is where the leg branches off, and no joint of it."""
        above = self.parents[hip]
        return bool(
            above >= 0 and np.linalg.norm((self.places[hip] - self.places[above])[[0, 2]]) < APART * self.height
        )

    def _ahead(self, legs: Sequence[tuple[tuple[int, int, int], float]], across: np.ndarray) -> np.ndarray:
        """The horizontal direction (3,) that the feet point to, which is along ``across`` turned by a right angle."""
        ways = []
        for (_, _, ankle), _ in legs:
            sole = self.skin[self._below(ankle)[self.owner]]
            ways.append(sole.mean(axis=0) - self.places[ankle] if len(sole) else np.zeros(3))
        ahead = np.cross(across, [0.0, 1.0, 0.0])
        return ahead * (1.0 if float(np.mean(ways, axis=0) @ ahead) >= 0.0 else -1.0)

    # --- arms ---

    def _arms(self, across: np.ndarray, middle: np.ndarray, legs: Sequence[int]) -> tuple[int, list[int], list[int]]:
        """The node where the arms part, the first node of each, and the one that moves the tip of its hand."""
        free = ~np.any([self._below(top)[self.owner] for top in legs], axis=0)
        out = np.where(free, (self.skin - middle) @ across, 0.0)
        tips = [int(self.owner[out.argmax()]), int(self.owner[out.argmin()])]
        chest = self._common(tips)
        if chest < 0 or chest in tips:
            raise self._refused("two arms", "none")
        tops = [next(node for node in ancestors(self.parents, tip) if self.parents[node] == chest) for tip in tips]
        return chest, tops, tips

    def _arm(self, top: int, tip: int, middle: np.ndarray, across: np.ndarray) -> tuple[tuple[int, int, int], float]:
        """Shoulder, elbow and wrist on the way from ``top`` to ``tip``, and how unlike a person's they are."""
        way = self._way(top, tip)
        best, least, bare = None, np.inf, np.inf
        for shoulder, elbow, wrist in combinations(way, 3):
            upper, fore = (
                np.linalg.norm(self.places[a] - self.places[b]) for a, b in ((shoulder, elbow), (elbow, wrist))
            )
            hand = self.skin[self._below(wrist)[self.owner]]
            beyond = np.linalg.norm(hand - self.places[wrist], axis=1).max() if len(hand) else 0.0
            whole = upper + fore + beyond
            if min(upper, fore) < 1e-6 * self.height:
                continue
            shares = upper / whole, (upper + fore) / whole, upper / (upper + fore)
            shares = (*shares, abs((self.places[shoulder] - middle) @ across) / whole)
            error = sum(abs(share - usual) for share, usual in zip(shares, ARM, strict=True))
            error += 5.0 * max(0.0, LEAST_ARM - whole / self.height)
            worth = error - (HAND if self._has_fingers(wrist) else 0.0)
            if worth < least:
                best, least, bare = (shoulder, elbow, wrist), worth, error
        if best is None:
            raise self._refused("shoulder, elbow and wrist in each arm", f"{len(way)} joints in one")
        return best, float(bare)

    def _has_fingers(self, node: int) -> bool:
        """Whether two branches or more leave ``node`` that are about as long as each other."""
        reach = [
            np.linalg.norm(self.places[self._below(child)] - self.places[node], axis=1).max()
            for child in self._children(node)
        ]
        return sum(one > FINGER * max(reach) for one in reach) > 1

    def _ends(self, side: str, ankle: int, arm_top: int, shoulder: int) -> dict[str, int]:
        """The ball of the foot, the middle one of the ankle's branches, and the collar, the arm's first node."""
        ends = {} if arm_top == shoulder else {f"{side}_collar": arm_top}
        toes = self._children(ankle)
        if toes:
            away = np.linalg.norm(self.places[toes] - self.places[toes].mean(axis=0), axis=1)
            ends[f"{side}_foot"] = toes[int(away.argmin())]
        return ends

    # --- head ---

    def _head(self, chest: int, limbs: set[int]) -> dict[str, int]:
        """Neck and head: on the way from ``chest``, or from below it, up to the highest skin."""
        limb = np.any([self._below(top) for top in limbs], axis=0)
        crown = int(np.where(limb[self.owner], -np.inf, self.skin[:, 1]).argmax())
        line = ancestors(self.parents, int(self.owner[crown]))
        trunk = ancestors(self.parents, chest)
        way = line[: next((k for k, node in enumerate(line) if node in trunk), 0)][::-1]
        if not way or self.skin[crown, 1] <= self.places[chest, 1]:
            return {}
        if len(way) == 1:
            return {"head": way[0]}
        neck, rest = way[0], way[1:]
        high = max(float(self.skin[crown, 1] - self.places[neck, 1]), 1e-9)
        moved = np.array([(self.owner == node).sum() for node in rest])
        shares = (self.places[rest, 1] - self.places[neck, 1]) / high
        worth = np.abs(shares - HEAD) - 0.2 * moved / max(moved.sum(), 1)
        return {"neck": neck, "head": rest[int(worth.argmin())]}

    def _lopsided(self, found: dict[str, int], across: np.ndarray, middle: np.ndarray) -> float:
        """How far the joints of one side are from those of the other in a mirror, of the height."""
        pairs = [(found[f"left_{name}"], found[f"right_{name}"]) for name in ("knee", "ankle", "elbow", "wrist")]
        left, right = (self.places[[pair[k] for pair in pairs]] - middle for k in (0, 1))
        mirrored = right - 2.0 * (right @ across)[:, None] * across
        return float(np.linalg.norm(left - mirrored, axis=1).mean()) / self.height
