"""How unlike training poses are, compiled: ``drape.body.pose_support.PoseSupport.novelty``."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.body.pose_support import PART_ENTRIES, PART_JOINTS, PoseSupport
from drape.body.skeleton import JOINT_COUNT
from drape.kernels.compiled import kernel
from drape.kernels.rotations import put_matrix, put_quaternion

_ENTRIES = np.concatenate(PART_ENTRIES).astype(np.int32)


class KeptPoses(NamedTuple):
    """A ``PoseSupport`` by columns: for each part the numbers of its kept poses (n, m) and the squares of their lengths
    (m,), float32; and what the square of a distance is divided by, (3,)."""

    numbers: tuple[np.ndarray, ...]
    squares: tuple[np.ndarray, ...]
    over: np.ndarray


def kept_poses(support: PoseSupport) -> KeptPoses:
    """The arrays of ``support`` as the kernel reads them."""
    numbers, squares = zip(*support.columns, strict=True)
    return KeptPoses(numbers, squares, (PART_JOINTS * support.limits**2).astype(np.float32))


def novelty(kept: KeptPoses, poses: np.ndarray) -> np.ndarray:
    """How unlike training each of ``poses`` (F, 24, 3) [rad] is, (F,): above 1 it is outside."""
    found = np.empty(len(poses))
    _write_novelty(np.array(poses, np.float64, order="C"), kept, _ENTRIES, found)
    return found


@kernel
def _write_novelty(poses, kept, entries, found):
    quaternion, matrix = np.empty(4), np.empty(9 * JOINT_COUNT)
    for frame in range(len(poses)):
        for joint in range(JOINT_COUNT):
            put_quaternion(poses[frame, joint], quaternion)
            put_matrix(quaternion, matrix[9 * joint : 9 * joint + 9])
        first, most = 0, np.float32(0.0)
        for part in range(len(kept.numbers)):
            numbers, squared, own = kept.numbers[part], kept.squares[part].copy(), np.float32(0.0)
            for i in range(len(numbers)):
                number = np.float32(matrix[entries[first + i]])
                own += number * number
                for m in range(len(squared)):
                    squared[m] -= np.float32(2.0) * number * numbers[i, m]
            first += len(numbers)
            least = squared[0]
            for m in range(len(squared)):
                least = min(least, squared[m])
            most = max(most, (least + own) / kept.over[part])
        found[frame] = np.sqrt(most)
