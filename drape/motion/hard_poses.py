"""The frames that quality is measured on: poses far from each other, chosen the same way every time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import igl
import numpy as np

from drape.body.model import BodyModel
from drape.body.pose_distance import BODY_JOINTS
from drape.errors import InputError
from drape.geometry import meshes
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.clip import MotionClip, clean_windows

POOL_FPS = 10.0
WINDOW = 5  # So many frames around a pose have no glitch.
UPRIGHT_COSINE = float(np.cos(np.deg2rad(45.0)))
OVERLAP_LIMIT_PCT = 2.5  # Cloth has no room where more of the body's vertices lie inside the body.
SKIN_M = 0.002


@dataclass(frozen=True, eq=False)
class HardPoses:
    """``poses`` (F, 24, 3) [rad] without translation, and where each comes from: ``labels`` are "clip:frame"."""

    poses: np.ndarray
    labels: tuple[str, ...]


def hard_poses(clips: Sequence[MotionClip], body: BodyModel, count: int) -> HardPoses:
    """Returns ``count`` poses of ``clips``: each the farthest from the T-pose and from those before it.

    Distance is between the rotation matrices of the body's joints. The root keeps its rotation. Frames are passed over
    that lean over by more than 45 degrees, that are not in the middle of one of the ``clean_windows``, or in which the
    body cuts into itself (``body_overlap_pct``). Raises ``InputError`` where too few are left.
    """
    pool, labels = _pool(clips)
    if len(pool) < count:
        raise InputError("motions", expected=f"at least {count} usable poses", got=str(len(pool)), cure="Add clips.")
    chosen = []
    for index in _farthest_first(pool):
        if body_overlap_pct(body, pool[index]) <= OVERLAP_LIMIT_PCT:
            chosen.append(index)
        if len(chosen) == count:
            return HardPoses(pool[chosen], tuple(labels[i] for i in chosen))
    raise InputError(
        "motions",
        expected=f"{count} poses without self-contact",
        got=str(len(chosen)),
        cure="Add clips or ask for fewer.",
    )


def body_overlap_pct(body: BodyModel, pose: np.ndarray) -> float:
    """Returns how many of the posed body's vertices lie inside the body after they are lifted by ``SKIN_M`` along their
    normals, in percent. Head and hands do not count. ``pose`` is (24, 3) [rad]."""
    posed = np.ascontiguousarray(body.posed_vertices(pose[None])[0])
    lifted = posed + SKIN_M * meshes.vertex_normals(posed, body.faces)
    detail = body.weights[:, [15, 22, 23]].sum(axis=1) > 0.5  # The mouth's inside and the fingers always touch.
    winding = igl.fast_winding_number(posed, body.faces, np.ascontiguousarray(lifted[~detail]))
    return 100.0 * float((np.asarray(winding) > 0.5).mean())


def _pool(clips: Sequence[MotionClip]) -> tuple[np.ndarray, list[str]]:
    poses, labels = [np.zeros((0, 24, 3))], []
    for clip in clips:
        stride = max(1, round(clip.fps / POOL_FPS))
        frames = np.array(clean_windows(clip, WINDOW, stride=stride), dtype=np.int64) + WINDOW // 2
        frames = frames[rotvec_to_matrix(clip.poses[frames, 0])[:, 1, 1] >= UPRIGHT_COSINE]
        poses.append(clip.poses[frames])
        labels += [f"{clip.name}:{frame}" for frame in frames]
    return np.concatenate(poses), labels


def _farthest_first(poses: np.ndarray) -> Iterator[int]:
    features = rotvec_to_matrix(poses[:, BODY_JOINTS]).reshape(len(poses), -1)
    t_pose = np.broadcast_to(np.eye(3), (features.shape[1] // 9, 3, 3)).reshape(-1)
    distance = ((features - t_pose) ** 2).sum(axis=1)
    for _ in range(len(poses)):
        index = int(distance.argmax())
        yield index
        distance = np.minimum(distance, ((features - features[index]) ** 2).sum(axis=1))
        distance[index] = -1.0
