"""Takes a draped garment from one pose of its body to another: with its bones, in small steps, off the skin."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT
from drape.errors import MotionError, NotFound
from drape.garment.avatars import Avatar
from drape.garment.rest_pose import WEIGHT_SMOOTHING_M, smoother, surface_weights
from drape.geometry.skinning import skin_points
from drape.motion.readers import read_motion
from drape.motion.samples import SAMPLES
from recovery.drape.seam_threads import in_numpy, sewn_relaxation
from recovery.pattern.pattern_mesh import PatternMesh
from recovery.sim.sdf import GridDistance

LARGEST_TURN_RAD = 0.35  # the most that a joint turns in one step
STEP_GRID_M = 0.02  # the body's distance between the first and the last pose need not be fine
CARRY_GAP_M = 0.008
ROUNDS = 40  # rounds of relaxation after every step


def read_pose(text: str) -> np.ndarray:
    """A pose (24, 3) [rad] from ``CLIP:FRAME`` or ``CLIP`` (frame 0), a motion file or a sample's name, or a JSON file.

    The JSON holds 72 numbers, or an object with them under "pose". Translations are left out.
    """
    name, _, frame_text = text.rpartition(":")
    if not (name and frame_text.lstrip("-").isdigit()):
        name, frame_text = text, "0"
    path = Path(name)
    if name not in SAMPLES and not path.is_file():
        raise NotFound(
            "pose",
            expected=f"a motion or JSON file, or one of {', '.join(sorted(SAMPLES))}; :FRAME behind it",
            got=text,
            cure="Check the path.",
        )
    if path.suffix == ".json":
        return _json_pose(path)
    clip = SAMPLES[name]() if name in SAMPLES else read_motion(path)
    frame, count = int(frame_text), len(clip.poses)
    if not -count <= frame < count:
        raise MotionError(
            "pose", expected=f"a frame from 0 to {count - 1}", got=frame_text, cure="Take a frame that the clip has."
        )
    return np.array(clip.poses[frame])


def _json_pose(path: Path) -> np.ndarray:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
        value = value["pose"] if isinstance(value, dict) else value
        pose = np.array(value, dtype=np.float64).reshape(JOINT_COUNT, 3)
    except (ValueError, KeyError, TypeError) as error:
        raise MotionError(
            path.name,
            expected=f"{3 * JOINT_COUNT} numbers [rad], alone or under 'pose'",
            got=f"{error}",
            cure="Write SMPL's axis-angles, joint after joint.",
        ) from error
    if not np.isfinite(pose).all():
        raise MotionError(path.name, expected="finite numbers", got="NaN or infinity", cure="Correct the pose.")
    return pose


def posed_joints(body: BodyModel, pose: np.ndarray | None) -> np.ndarray:
    """Joints [m] (24, 3) of ``body`` in ``pose`` (24, 3), or in the T-pose."""
    return body.joints_template if pose is None else body.posed_joints(pose[None])[0]


def pose_steps(pose: np.ndarray) -> np.ndarray:
    """Poses (S, 24, 3) from the T-pose, left out, to ``pose`` (24, 3); joints turn evenly about their own axes."""
    angles = np.linalg.norm(pose[1:], axis=1)  # the root turns all at once: the garment turns with it
    steps = max(1, int(np.ceil(angles.max() / LARGEST_TURN_RAD)))
    return np.linspace(0.0, 1.0, steps + 1)[1:, None, None] * pose


def move_with_bones(
    nodes: np.ndarray, faces: np.ndarray, body: BodyModel, before: np.ndarray, after: np.ndarray
) -> np.ndarray:
    """Garment ``nodes`` [m] (N, 3) on the body in pose ``before`` (24, 3), moved with its bones to pose ``after``."""
    rotations, translations = body.bones(np.stack([before, after]))
    skin = Avatar(body.posed_vertices(before[None])[0], body.faces, 0.0, "posed body")
    weights = smoother(nodes, faces, WEIGHT_SMOOTHING_M)(surface_weights(nodes, skin) @ body.weights)
    weights = weights / weights.sum(axis=1, keepdims=True)
    turn = rotations[1] @ rotations[0].transpose(0, 2, 1)
    shift = translations[1] - np.einsum("jab,jb->ja", turn, translations[0])
    return np.asarray(skin_points(nodes, weights, turn, shift))


def to_pose(mesh: PatternMesh, nodes: np.ndarray, body: BodyModel, pose: np.ndarray) -> np.ndarray:
    """Returns ``nodes`` [m] (N, 3) of a garment on ``body`` in the T-pose, in ``pose`` (24, 3); clear of it, not at
    rest.
    """
    before = np.zeros((JOINT_COUNT, 3))
    for after in pose_steps(pose):
        nodes = move_with_bones(nodes, mesh.faces, body, before, after)
        skin = body.posed_vertices(after[None])[0]
        distance = in_numpy(GridDistance.from_mesh(skin, body.faces, spacing_m=STEP_GRID_M))
        relaxation = sewn_relaxation(mesh, distance, gap_m=CARRY_GAP_M)
        for _ in range(ROUNDS):
            nodes = relaxation.step(nodes)
        before = after
    return nodes
