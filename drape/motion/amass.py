"""Motion clips from npz files: AMASS's layout, and the product's own."""

from __future__ import annotations

import math
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drape.body.skeleton import JOINT_COUNT
from drape.errors import MotionError
from drape.geometry.rotations import matrix_to_rotvec, rotvec_to_matrix
from drape.motion.clip import MotionClip, check_frame_count

MAX_ARRAY_BYTES = 512 << 20
"""Largest array [bytes] that is read: about an hour of AMASS in float64 at 120 Hz."""

Y_FROM_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Turns z up, facing -y, into y up, facing +z."""

# Columns of a two-dimensional pose array -> leading joints that are SMPL's own:
# SMPL, its 22 body joints, SMPL-H and SMPL-X (whose further joints are fingers and face).
_BODY_JOINTS = {72: 24, 66: 22, 156: 22, 165: 22}

# Columns of the arrays that newer files have in place of, or beside, ``poses``.
_PARTS = {"root_orient": 3, "pose_body": 63}

_RATE_KEYS = ("mocap_framerate", "mocap_frame_rate", "mocap_frame_rate_hz", "fps")


def read_amass(path: Path, *, most_frames: int | None = None) -> MotionClip:
    """Returns the clip of an npz with ``poses``, ``trans`` and a frame rate, turned to y up.

    Flat poses (F, 72 | 66 | 156 | 165) are AMASS's: z up; so are ``root_orient`` (F, 3) with ``pose_body`` (F, 63).
    Poses (F, 24, 3) are the product's: y up. A key ``up`` ("y" or "z") overrules. Nothing is unpickled. Raises
    ``MotionError`` for any other file, and ``TooLarge`` for more than ``most_frames`` frames.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            return _clip(_Arrays(path, archive), most_frames)
    except (OSError, zipfile.BadZipFile) as cause:
        raise MotionError(
            path.name,
            expected="a readable npz file",
            got=str(cause),
            cure="Check the path; fetch the file again if it was cut off.",
        ) from cause


def rotate_world(clip_poses: np.ndarray, trans: np.ndarray, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns SMPL poses (F, 24, 3) [rad] and root translations (F, 3) after the world is turned by ``rotation`` (3, 3)
    about the origin."""
    poses = clip_poses.copy()
    poses[:, 0] = matrix_to_rotvec(rotation @ rotvec_to_matrix(clip_poses[:, 0]))
    return poses, trans @ rotation.T


def _clip(arrays: _Arrays, most_frames: int | None) -> MotionClip:
    poses, default_up = _joint_poses(arrays)
    check_frame_count(arrays.path.name, len(poses), most_frames)
    trans = arrays.numbers("trans")
    if trans.shape != (len(poses), 3):
        raise arrays.fault(
            "trans", f"shape ({len(poses)}, 3)", f"shape {trans.shape}", "Give one translation per pose."
        )
    up = arrays.text("up", default_up)
    if up not in ("y", "z"):
        raise arrays.fault("up", "'y' or 'z'", repr(up), "Correct or remove the key 'up'.")
    if up == "z":
        _check_finite_root(arrays, poses, trans)
        poses, trans = rotate_world(poses, trans, Y_FROM_Z)
    fps, name = _frame_rate(arrays), arrays.text("name", arrays.path.stem)
    betas = arrays.numbers("betas") if "betas" in arrays.names else None
    try:
        return MotionClip(poses=poses, trans=trans, fps=fps, name=name, betas=betas)
    except MotionError as error:
        raise arrays.fault(error.name, error.expected, error.got, error.cure) from error


def _check_finite_root(arrays: _Arrays, poses: np.ndarray, trans: np.ndarray) -> None:
    for name, array in (("poses", poses), ("trans", trans)):
        if not np.isfinite(array).all():
            raise arrays.fault(name, "finite numbers", "NaN or infinity", "Remove or repair the broken frames.")


def _joint_poses(arrays: _Arrays) -> tuple[np.ndarray, str]:
    """Poses (F, 24, 3), and the up axis that this layout has by default."""
    if "poses" not in arrays.names and set(_PARTS) <= arrays.names:
        poses = _joined(arrays)
    else:
        poses = arrays.numbers("poses")
    if poses.ndim == 3 and poses.shape[1:] == (JOINT_COUNT, 3):
        return poses, "y"
    joints = _BODY_JOINTS.get(poses.shape[1]) if poses.ndim == 2 else None
    if joints is None:
        wanted = "shape (F, 24, 3) or (F, 72), (F, 66), (F, 156), (F, 165)"
        cure = "Export SMPL, SMPL-H or SMPL-X poses as axis-angle."
        raise arrays.fault("poses", wanted, f"shape {poses.shape}", cure)
    full = np.zeros((len(poses), JOINT_COUNT, 3))
    full[:, :joints] = poses[:, : 3 * joints].reshape(len(poses), joints, 3)
    return full, "z"


def _joined(arrays: _Arrays) -> np.ndarray:
    """Poses (F, 66) of a file that has root and body apart."""
    parts = [arrays.numbers(name) for name in _PARTS]
    for name, part, width in zip(_PARTS, parts, _PARTS.values(), strict=True):
        if part.shape != (len(parts[0]), width):
            wanted = f"shape ({len(parts[0])}, {width})"
            raise arrays.fault(name, wanted, f"shape {part.shape}", "Store one row of rotation vectors per frame.")
    return np.concatenate(parts, axis=1)


def _frame_rate(arrays: _Arrays) -> float:
    for key in _RATE_KEYS:
        if key in arrays.names:
            value = arrays.numbers(key)
            if value.size != 1:
                raise arrays.fault(key, "one number", f"shape {value.shape}", "Store the frame rate as a scalar.")
            return float(value.reshape(()))
    raise arrays.fault(
        "frame rate", f"a key {' or '.join(_RATE_KEYS[:2])}", "none of them", "Store the frame rate in the file."
    )


@dataclass(frozen=True)
class _Arrays:
    """The arrays of an open npz, each checked against its declared size before it is read."""

    path: Path
    archive: zipfile.ZipFile

    @property
    def names(self) -> set[str]:
        return {name.removesuffix(".npy") for name in self.archive.namelist()}

    def fault(self, name: str, expected: str, got: str, cure: str) -> MotionError:
        return MotionError(f"{self.path.name}: {name}", expected=expected, got=got, cure=cure)

    def numbers(self, name: str) -> np.ndarray:
        array = self._read(name)
        if array.dtype.kind not in "fiu":
            raise self.fault(name, "real numbers", f"dtype {array.dtype}", "Store the array as float32.")
        return array.astype(np.float64)

    def text(self, name: str, default: str) -> str:
        if name not in self.names:
            return default
        array = self._read(name)
        if array.dtype.kind != "U" or array.size != 1:
            raise self.fault(
                name, "one string", f"dtype {array.dtype}, shape {array.shape}", f"Store {name!r} as one string."
            )
        return str(array.reshape(()))

    def _read(self, name: str) -> np.ndarray:
        if name not in self.names:
            held = ", ".join(sorted(self.names)[:12]) or "nothing"
            raise self.fault(
                name,
                f"an array {name!r}",
                f"a file that holds {held}",
                "Pass an AMASS-like npz with poses, trans and a frame rate.",
            )
        try:
            entry = self.archive.getinfo(f"{name}.npy")
            if entry.file_size > MAX_ARRAY_BYTES:
                raise self.fault(
                    name, f"at most {MAX_ARRAY_BYTES} bytes", str(entry.file_size), "Cut the clip into shorter files."
                )
            self._check_header(name, entry)
            with self.archive.open(entry) as stream:
                return np.lib.format.read_array(stream, allow_pickle=False)
        except (
            ValueError,
            KeyError,
            EOFError,
            NotImplementedError,
            RuntimeError,
            zipfile.BadZipFile,
            zlib.error,
        ) as cause:
            raise self.fault(
                name,
                "a plain array of numbers or text",
                str(cause),
                "Save the file again with numpy.savez, without objects.",
            ) from cause

    def _check_header(self, name: str, entry: zipfile.ZipInfo) -> None:
        # numpy allocates what the header declares before it reads the bytes.
        with self.archive.open(entry) as stream:
            major, _ = np.lib.format.read_magic(stream)
            read_header = np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
            shape, _, dtype = read_header(stream)
            declared, held = math.prod(shape) * dtype.itemsize, entry.file_size - stream.tell()
        if not dtype.hasobject and declared != held:
            raise self.fault(
                name, f"{declared} bytes, as its header declares", f"{held}", "Fetch the file again; it is damaged."
            )
