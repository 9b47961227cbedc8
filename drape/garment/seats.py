"""Where hats, glasses and shoes sit on what carries them: a hat on the forehead, glasses on the nose, a shoe round its
foot. Who finds a thing's wearer knows that only roughly."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.geometry.closest import ClosedMesh

SEAT_COUNT = 400  # points that are looked at
EYES_M, FOREHEAD_M, CROWN_M = 0.032, 0.072, 0.03  # above the tip of the nose; a hat's top is no lower under the crown
LENSES_M, CLEAR_M = 0.035, 0.002  # how far behind the foremost point glasses have lenses, and steps that they take
BRIDGE_M, NOSE_SHARE = 0.03, 0.1  # lenses are this far behind the nose's tip at most; share of them in the skin
# Least and most extents of glasses [m] across, up and back. Behind the lenses less than BETWEEN_SHARE of their points
# are nearer to the middle than BETWEEN of their width.
GLASSES_M, BETWEEN, BETWEEN_SHARE = ((0.11, 0.175), (0.02, 0.085), (0.02, 0.2)), 0.35, 0.02
# Moves of a hat that are tried: up or down, and forward or back.
RISES_M, DEPTHS_M = np.arange(-0.15, 0.1501, 0.01), np.arange(-0.06, 0.0601, 0.02)
RIM_M, RIM_COST_M = 0.05, 0.03  # a hat's rim is this near to the head; distance from the forehead that costs 1
DEEP_M, DEEP_COST, TIGHT_M = 0.002, 20.0, 0.01  # hats up to so much too tight are made larger (``rest_mesh``)
SHOE_STEPS_M, SHOE_MOST_M, SHOE_FAR_M, SHOE_WAY_M = (0.04, 0.02, 0.01, 0.005), 0.06, 0.03, 1.0


def is_as_large(points: np.ndarray, limits: Sequence[tuple[float, float]]) -> bool:
    """Returns whether the extents of ``points`` [m] (N, 3) along x, y and z lie in ``limits`` [m], a least and a most
    for each."""
    extents = zip(np.ptp(points, axis=0), limits, strict=True)
    return all(least <= extent <= most for extent, (least, most) in extents)


def are_glasses(points: np.ndarray) -> bool:
    """Returns whether ``points`` [m] (N, 3), y up and facing +z, have the size of glasses, with nothing between the
    temples."""
    if not is_as_large(points, GLASSES_M):
        return False
    extent = np.ptp(points, axis=0)
    middle = 0.5 * (points[:, 0].min() + points[:, 0].max())
    behind = points[:, 2] < points[:, 2].max() - LENSES_M
    return bool((behind & (np.abs(points[:, 0] - middle) < BETWEEN * extent[0])).mean() < BETWEEN_SHARE)


class Seat:
    """The ``skin`` [m] (V, 3) of ``body``, upright and facing +z, on which hats, glasses and shoes are seated."""

    def __init__(self, skin: np.ndarray, body: BodyModel) -> None:
        self.skin, self.body = skin, body
        self._closed = ClosedMesh(skin, body.faces)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Returns the distances [m] (N,) of ``points`` [m] (N, 3) from the skin, negative inside the body."""
        return self._closed.signed_closest(points)[0]

    @cached_property
    def _head(self) -> np.ndarray:
        return self.skin[self.body.weights.argmax(axis=1) == JOINT_NAMES.index("head")]

    @cached_property
    def _nose(self) -> np.ndarray:
        return self._head[self._head[:, 2].argmax()]

    def way(self, points: np.ndarray, bone: str) -> np.ndarray:
        """Returns the displacement [m] (3,) that brings an accessory with ``points`` [m] (N, 3) to its seat on the
        ``bone``: a shoe round the foot, glasses onto the nose, a hat onto the forehead. It is zero for other bones, and
        for what is low on the head."""
        points = points[:: max(1, len(points) // SEAT_COUNT)]
        if bone.endswith("ankle"):
            return self._round_foot(points)
        if bone != "head":
            return np.zeros(3)
        if are_glasses(points):
            return self._on_nose(points)
        high = points[:, 1].max() > self._head[:, 1].max() - CROWN_M
        return self._on_forehead(points) if high else np.zeros(3)

    def _on_nose(self, points: np.ndarray) -> np.ndarray:
        front = points[points[:, 2] > points[:, 2].max() - LENSES_M]
        across, up = 0.5 * (front[:, :2].min(axis=0) + front[:, :2].max(axis=0))
        back = self._nose[2] - BRIDGE_M - front[:, 2].max()
        way = np.array([self._nose[0] - across, self._nose[1] + EYES_M - up, back])
        for _ in range(40):  # forward, until the lenses are off the nose and the brows
            if (self.distance(front + way) < 0.0).mean() < NOSE_SHARE:
                break
            way[2] += CLEAR_M
        return way

    def _on_forehead(self, points: np.ndarray) -> np.ndarray:
        front = (np.abs(points[:, 0] - self._nose[0]) < RIM_COST_M) & (points[:, 2] > self._head[:, 2].mean())

        def cost(way: np.ndarray) -> float:
            distance = self.distance(points + way)
            rim = points[front & (distance < RIM_M), 1] + way[1]
            off = abs(rim.min() - self._nose[1] - FOREHEAD_M) if len(rim) else RIM_M
            deep = DEEP_COST * float((distance < -TIGHT_M).mean())
            return deep + (off + 0.5 * abs(way[2])) / RIM_COST_M

        best, least = np.zeros(3), np.inf
        for depth in sorted(DEPTHS_M, key=abs):  # the move forward or back alone costs as much
            if 0.5 * abs(depth) / RIM_COST_M >= least:
                break
            for rise in RISES_M:
                if (found := cost(way := np.array([0.0, rise, depth]))) < least:
                    best, least = way, found
        return best

    def _round_foot(self, points: np.ndarray) -> np.ndarray:
        def cost(way: np.ndarray) -> float:
            distance = self.distance(points + way)
            inside = np.clip((-distance - DEEP_M) / CLEAR_M, 0.0, 4.0)
            outside = np.clip(distance, 0.0, SHOE_FAR_M) / SHOE_FAR_M
            return float((inside + outside).mean() + np.linalg.norm(way) / SHOE_WAY_M)

        way, least = np.zeros(3), cost(np.zeros(3))
        for step in SHOE_STEPS_M:
            for move in step * np.concatenate([np.eye(3), -np.eye(3)]):
                while np.abs(way + move).max() <= SHOE_MOST_M and (found := cost(way + move)) < least:
                    way, least = way + move, found
        return way
