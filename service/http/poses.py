"""Checks on poses that no type can make, shared by REST and stream."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drape.body.model import BodyModel
from drape.errors import BodyError, MotionError
from service.errors import TooLarge

# Beyond these the numbers are a mistake of unit, and squares overflow.
ANGLE_LIMIT_RAD = 1000.0
PLACE_LIMIT_M = 1e6
BETA_LIMIT = 20.0


def check_poses(poses: np.ndarray, trans: np.ndarray) -> None:
    """Refuses rotation vectors (F, 24, 3) [rad] and translations (F, 3) [m] that are finite but senseless."""
    _check_limit("poses", poses, ANGLE_LIMIT_RAD, "rad", "Send rotation vectors in radians.")
    _check_limit("trans", trans, PLACE_LIMIT_M, "m", "Send root translations in metres.")


def _check_limit(name: str, array: np.ndarray, limit: float, unit: str, cure: str) -> None:
    beyond = ~(np.abs(array) <= limit)  # the negation also catches NaN
    if beyond.any():
        index = tuple(int(i) for i in np.argwhere(beyond)[0])
        place = "".join(f"[{i}]" for i in index)
        raise MotionError(f"{name}{place}", expected=f"at most {limit:g} {unit}", got=f"{array[index]:g}", cure=cure)


def motion_arrays(
    poses: Sequence[object] | np.ndarray, trans: Sequence[object] | np.ndarray | None, *, max_frames: int
) -> tuple[np.ndarray, np.ndarray]:
    """Checked poses (F, 24, 3) and translations (F, 3), float64; translations default to zero."""
    if not len(poses):
        raise MotionError("poses", expected="at least 1 frame", got="0", cure="Send one pose or more.")
    if len(poses) > max_frames:
        raise TooLarge(
            "poses", expected=f"at most {max_frames} frames", got=f"{len(poses)}", cure="Send the clip in pieces."
        )
    if trans is not None and len(trans) != len(poses):
        raise MotionError(
            "trans",
            expected=f"one translation per frame, {len(poses)}",
            got=str(len(trans)),
            cure="Send as many as poses, or none.",
        )
    rotations = np.asarray(poses, dtype=np.float64)
    places = np.zeros((len(poses), 3)) if trans is None else np.asarray(trans, dtype=np.float64)
    check_poses(rotations, places)
    return rotations, places


def shape_array(betas: Sequence[float] | None, body: BodyModel) -> np.ndarray:
    """Checked shape coefficients (S,), zeros where none were sent."""
    shape = body.check_betas(np.asarray(betas if betas is not None else [], dtype=np.float64))
    if (np.abs(shape) > BETA_LIMIT).any():
        index = int(np.argmax(np.abs(shape)))
        raise BodyError(
            f"betas[{index}]",
            expected=f"at most {BETA_LIMIT:g}",
            got=f"{shape[index]:g}",
            cure="Shapes are in standard deviations.",
        )
    return shape
