"""The motion of the body's root. A node of a file takes it over, so that a garment's own vertices move little."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.geometry.rotations import rotvec_to_matrix, rotvec_to_quaternion


@dataclass(frozen=True, eq=False)
class RootMotion:
    """The motion of a body's root in F frames, float64: rotation vectors ``turn`` [rad] (F, 3), and positions ``place``
    [m] (F, 3) in the world."""

    turn: np.ndarray
    place: np.ndarray

    def __len__(self) -> int:
        return len(self.turn)

    def rotation(self, frame: int) -> np.ndarray:
        """Returns the rotation R_world_root (3, 3) in ``frame``."""
        return rotvec_to_matrix(self.turn[frame])

    def towards_root(self, points: np.ndarray, frame: int) -> np.ndarray:
        """Returns ``points`` [m] (V, 3) of the world in the frame of the root in ``frame``."""
        return (points - self.place[frame]) @ self.rotation(frame)

    def places_of(self, point: np.ndarray) -> np.ndarray:
        """Returns where the ``point`` [m] (3,) of the root's frame is in the world, in all frames [m] (F, 3)."""
        return self.place + rotvec_to_matrix(self.turn) @ point


def keys(turn: np.ndarray) -> np.ndarray:
    """Returns rotation vectors ``turn`` [rad] (F, ..., 3) as unit quaternions xyzw (F, ..., 4), float32, as glTF's
    animations have them.

    A quaternion and its negative turn alike, but players interpolate between them the long way round, so neighbours in
    time are on one side of the sphere.
    """
    return quaternion_keys(rotvec_to_quaternion(np.asarray(turn, dtype=np.float64)))


def quaternion_keys(turns: np.ndarray) -> np.ndarray:
    """Returns unit quaternions ``turns`` wxyz (F, ..., 4) as xyzw (F, ..., 4), float32, with the signs of ``keys``."""
    wxyz = np.array(turns)
    for frame in range(1, len(wxyz)):
        wxyz[frame] *= np.where((wxyz[frame] * wxyz[frame - 1]).sum(axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    return np.roll(wxyz, -1, axis=-1).astype(np.float32)
