"""The motion of the body's root. A node of a file takes it over, so that a garment's own vertices move little."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.geometry.rotations import rotvec_to_matrix, rotvec_to_quaternion


@dataclass(frozen=True, eq=False)
class RootMotion:
    """Per frame the rotation vector (F, 3) [rad] and the place (F, 3) [m] of the root, float64."""

    turn: np.ndarray
    place: np.ndarray

    def __len__(self) -> int:
        return len(self.turn)

    def rotation(self, frame: int) -> np.ndarray:
        """R_world_root (3, 3) of one frame."""
        return rotvec_to_matrix(self.turn[frame])

    def towards_root(self, points: np.ndarray, frame: int) -> np.ndarray:
        """Returns ``points`` (V, 3) [m] of the world, moved into the frame of the root in ``frame``."""
        return (points - self.place[frame]) @ self.rotation(frame)

    def places_of(self, point: np.ndarray) -> np.ndarray:
        """Returns where the ``point`` (3,) [m] of the root's frame is in the world [m] (F, 3)."""
        return self.place + rotvec_to_matrix(self.turn) @ point


def keys(turn: np.ndarray) -> np.ndarray:
    """Rotation vectors (F, ..., 3) as quaternions xyzw (F, ..., 4) float32, as glTF's animations have them.

    A quaternion and its negative turn alike, but players interpolate between them the long way round, so neighbours in
    time are on one side of the sphere.
    """
    return quaternion_keys(rotvec_to_quaternion(np.asarray(turn, dtype=np.float64)))


def quaternion_keys(turns: np.ndarray) -> np.ndarray:
    """Returns the keys that ``keys`` does, for quaternions wxyz (F, ..., 4)."""
    wxyz = np.array(turns)
    for frame in range(1, len(wxyz)):
        wxyz[frame] *= np.where((wxyz[frame] * wxyz[frame - 1]).sum(axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    return np.roll(wxyz, -1, axis=-1).astype(np.float32)
