"""How unlike training poses are: ``drape.body.pose_distance.PoseSupport.novelty``, by the engine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.body.features import joint_rotations
from drape.body.pose_distance import PART_ENTRIES, PART_JOINTS, PoseSupport
from drape.engine.calls import call_with_scratch
from drape.engine.packer import Recorded
from drape.network.dense import Layer, body_layer


@dataclass(frozen=True, eq=False)
class KeptPoses(Recorded):
    """A ``PoseSupport`` as the engine reads it.

    For each part ``parts`` has a layer that gives |k|^2 - 2 k.x for each kept pose k, and ``counts`` how many poses are
    kept. ``entry`` says which entry of a pose's matrices each input of the layers is, and ``over`` is what the square
    of a distance is divided by.
    """

    parts: tuple[Layer, ...]
    counts: np.ndarray
    entry: np.ndarray
    over: np.ndarray


def kept_poses(support: PoseSupport) -> KeptPoses:
    """The poses of ``support`` as the engine reads them."""
    return KeptPoses(
        tuple(body_layer(-2.0 * columns.T, squares) for columns, squares in support.columns),
        np.array([len(squares) for _, squares in support.columns], np.int32),
        np.concatenate(PART_ENTRIES).astype(np.int32),
        (PART_JOINTS * support.limits**2).astype(np.float32),
    )


def novelty(kept: KeptPoses, poses: np.ndarray) -> np.ndarray:
    """Returns how unlike training each of ``poses`` (F, 24, 3) [rad] is, (F,): above 1 it is farther than it may be."""
    matrices, found = joint_rotations(poses)[1].astype(np.float32), np.empty(len(poses), np.float32)
    call_with_scratch("novelty", np.float32, kept, matrices, len(poses), found)
    return found
