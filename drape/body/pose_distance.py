"""How far a pose lies from those that a network was trained on, of which a few hundred are kept.

Legs and trunk with arms are compared apart, since training mixes the legs of one frame with the trunk of another. So is
the tilt of the pelvis, which the network knows by the direction of gravity. A turn about the vertical does not count.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np

from drape.body.features import joint_rotations
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES
from drape.errors import ArtifactError
from drape.files.packed import UNREADABLE
from drape.geometry.rotations import matrix_to_rotvec, rotvec_to_matrix, sixd_to_matrix

BODY_JOINTS = range(1, 22)  # The root and the hands, which are rigid, are left out.
LEGS = tuple(i for i in BODY_JOINTS if JOINT_NAMES[i].split("_")[-1] in ("hip", "knee", "ankle", "foot"))
TRUNK = tuple(i for i in BODY_JOINTS if i not in LEGS)
PARTS = ("legs", "trunk", "tilt")
SIXD = 6  # A rotation's 6D form has so many numbers.
STEPS = 127  # Steps in a stored number, which is an entry of a rotation matrix.
# Entries of a rotation matrix: its 6D form, and the world's up in its frame.
_FIRST_COLUMNS, _UP = (0, 3, 6, 1, 4, 7), (3, 4, 5)
PART_ENTRIES = (*([9 * joint + i for joint in joints for i in _FIRST_COLUMNS] for joints in (LEGS, TRUNK)), _UP)
_TAKEN = np.concatenate(PART_ENTRIES)  # Entries of a pose's matrices that are compared, part after part.
_ENDS = np.cumsum([len(part) for part in PART_ENTRIES]).tolist()
PART_SLICES = tuple(slice(end - len(part), end) for part, end in zip(PART_ENTRIES, _ENDS, strict=True))
PART_JOINTS = np.array([max(1, len(part) // SIXD) for part in PART_ENTRIES], dtype=np.float32)


@dataclass(frozen=True, eq=False)
class PoseSupport:
    """Poses of training that are kept, and how far from them a pose may lie.

    ``legs`` (n, 48), ``trunk`` (n, 78) and ``tilt`` (m, 3) are the kept poses, part by part, int8 in steps of 1/127.
    Columns are the 6D rotations (Zhou et al. 2019) of the part's joints from their parents; of the tilt they are the
    world's up axis in the frame of the pelvis. ``limits`` (3,) are the largest distances of legs, trunk and tilt that
    count as like training.
    """

    legs: np.ndarray
    trunk: np.ndarray
    tilt: np.ndarray
    limits: np.ndarray

    @cached_property
    def columns(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """For legs, trunk and tilt in turn: the kept poses, one a column (48, 78 or 3, n), and the squares (n,) of
        these columns' lengths, float32."""
        rows = [getattr(self, name).astype(np.float32) / np.float32(STEPS) for name in PARTS]
        return tuple((np.ascontiguousarray(one.T), (one**2).sum(axis=1)) for one in rows)

    def distances(self, poses: np.ndarray) -> np.ndarray:
        """Returns the distances (F, 3) of ``poses`` (F, 24, 3) [rad] from the nearest kept legs, trunk and tilt: the
        difference of their 6D rotations, root mean square over the part's joints."""
        rows, squared = pose_rows(poses).astype(np.float32), np.empty((len(poses), len(PARTS)), dtype=np.float32)
        for number, (part, (turned, squares)) in enumerate(zip(PART_SLICES, self.columns, strict=True)):
            one = rows[:, part]
            squared[:, number] = (squares - 2.0 * one @ turned).min(axis=1) + (one * one).sum(axis=1)
        return np.sqrt(np.maximum(squared, 0.0) / PART_JOINTS)

    def novelty(self, poses: np.ndarray) -> np.ndarray:
        """Returns how unlike training ``poses`` (F, 24, 3) [rad] are, (F,): the largest of their ``distances``, each
        over its limit. Above 1 a pose is unlike training."""
        return (self.distances(poses) / self.limits).max(axis=-1)

    def to_bytes(self) -> bytes:
        """Returns the npz file that ``read_pose_support`` reads."""
        file = io.BytesIO()
        np.savez_compressed(file, **{item.name: getattr(self, item.name) for item in fields(self)})
        return file.getvalue()


def pose_rows(poses: np.ndarray) -> np.ndarray:
    """Returns the numbers (F, 129) in which ``poses`` (F, 24, 3) [rad] are compared: the columns of ``PoseSupport``, of
    legs, trunk and tilt in turn."""
    matrices = joint_rotations(poses)[1].reshape(len(poses), 9 * JOINT_COUNT)
    return matrices.take(_TAKEN, axis=1)


def pose_parts(poses: np.ndarray) -> dict[str, np.ndarray]:
    """Returns the ``pose_rows`` of ``poses`` (F, 24, 3) [rad] part by part: "legs" (F, 48), "trunk" (F, 78) and "tilt"
    (F, 3)."""
    rows = pose_rows(poses)
    return {name: rows[:, part] for name, part in zip(PARTS, PART_SLICES, strict=True)}


def mixed_poses(support: PoseSupport, count: int) -> np.ndarray:
    """Returns n = ``count`` poses (n, 24, 3) [rad] that each join the legs, the trunk and the tilt of other kept poses,
    as training does; fewer where fewer are kept. They are the same each time."""
    draw = np.random.default_rng(0)
    turns = np.tile(np.eye(3), (min(count, len(support.legs), len(support.trunk)), JOINT_COUNT, 1, 1))
    for rows, joints in ((support.legs, LEGS), (support.trunk, TRUNK)):
        kept = draw.permutation(len(rows))[: len(turns)]
        sixd = rows[kept].reshape(len(turns), len(joints), SIXD).astype(np.float64) / STEPS
        turns[:, list(joints)] = sixd_to_matrix(sixd)
    up = support.tilt[draw.integers(0, len(support.tilt), len(turns))].astype(np.float64)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    # It is the axis of the shortest turn from there to y.
    axis = np.stack([-up[:, 2], np.zeros(len(up)), up[:, 0]], axis=1)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    turns[:, 0] = rotvec_to_matrix(axis / np.maximum(sine, 1e-9) * np.arctan2(sine, up[:, 1:2]))
    return matrix_to_rotvec(turns)


def read_pose_support(path: Path) -> PoseSupport:
    """Returns the pose support in the file at ``path``, which holds what ``to_bytes`` returns. Raises ``ArtifactError``
    for any other content."""
    try:
        with np.load(path, allow_pickle=False) as file:
            support = PoseSupport(**{item.name: file[item.name] for item in fields(PoseSupport)})
    except UNREADABLE as error:
        raise _unreadable(path, str(error)) from error
    wide = [rows.shape[1] for rows in pose_parts(np.zeros((1, JOINT_COUNT, 3))).values()]
    shapes = [getattr(support, name).shape for name in PARTS]
    fits = all(len(shape) == 2 and shape[0] > 0 for shape in shapes) and [shape[1] for shape in shapes] == wide
    if not fits or support.limits.shape != (len(PARTS),) or not (support.limits > 0.0).all():
        raise _unreadable(path, f"shapes {shapes}, limits {support.limits}")
    return support


def _unreadable(path: Path, got: str) -> ArtifactError:
    return ArtifactError(
        path.name, expected="kept poses", got=got[:200], cure="Run python -m training.pose_support, or leave it out."
    )
