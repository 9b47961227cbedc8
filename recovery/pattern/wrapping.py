"""Panels bent round a limb before they are sewn: sleeves round an arm, bands round waist, neck and wrist.

A panel that is to enclose a limb cannot start flat beside it, because the threads between its own two edges would pass
through the limb. On a cylinder it lies without stretch: with the panel's point (u, v)

    world = origin + v axis + R (sin(u / R) (axis x front) + cos(u / R) front)
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from recovery.pattern.drafting import FRONT, Drafted, Side, draft
from recovery.pattern.model import Placement

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Tube:
    """A cylinder of ``radius_m``: the warp runs along the unit vector ``axis``, u = 0 lies in direction ``front``."""

    origin: Vector
    axis: Vector
    front: Vector
    radius_m: float

    def place(self, points: np.ndarray) -> np.ndarray:
        """World positions [m] (N, 3) of ``points`` (u, v) [m] (N, 2)."""
        axis, front = np.array(self.axis), np.array(self.front)
        angle = points[:, :1] / self.radius_m
        round_it = np.sin(angle) * np.cross(axis, front) + np.cos(angle) * front
        return np.array(self.origin) + points[:, 1:] * axis + self.radius_m * round_it

    def tangent(self, point: np.ndarray) -> Placement:
        """The flat placement that touches the tube at ``point`` (u, v)."""
        axis = np.array(self.axis)
        place = self.place(point[None])[0]
        normal = (place - np.array(self.origin) - point[1] * axis) / self.radius_m
        turn = np.stack([np.cross(axis, normal), axis, normal], axis=1)
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", UserWarning
            )  # a panel seen edge-on has no single set of angles; any will do
            angles = Rotation.from_matrix(turn).as_euler("xyz", degrees=True)
        return Placement(tuple(angles.tolist()), tuple(place.tolist()))


@dataclass(frozen=True)
class Wrap:
    """A panel round a ``tube``; the origin of the panel's frame lies at ``offset`` = (u, v) [m] there."""

    tube: Tube
    offset: tuple[float, float]

    def place(self, points: np.ndarray) -> np.ndarray:
        """World positions [m] (N, 3) of the panel's ``points`` [m] (N, 2)."""
        return self.tube.place(points + np.array(self.offset))


def draft_round(name: str, sides: Sequence[Side], tube: Tube, *, flip: bool = False) -> tuple[Drafted, Wrap]:
    """The panel bounded by ``sides``, drawn in the tube's (u, v) as seen from outside; ``flip`` mirrors u."""
    drafted = draft(name, sides, rotation=FRONT, z=0.0, flip=flip)
    u, v, _ = drafted.panel.placement.translation_m
    wrap = Wrap(tube, (u, v))
    placement = tube.tangent(np.array([u, v]))
    return Drafted(replace(drafted.panel, placement=placement), drafted.numbers), wrap
