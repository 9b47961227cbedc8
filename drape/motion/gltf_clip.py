"""Motion clips from animations in glTF files: GLB, glTF, VRM and VRMA (glTF 2.0, section 3.11)."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import ValidationError

from drape.errors import DrapeError, MotionError, TooLarge
from drape.files.beside import file_beside
from drape.files.gltf import FILE_BYTES, GltfFile
from drape.files.gltf_json import EXPORT, FIRST_ONLY, Index, Part, Text
from drape.files.gltf_nodes import node_matrix, tree_of, world_matrices
from drape.geometry.rotations import matrix_to_quaternion, quaternion_slerp
from drape.motion.clip import MotionClip, check_frame_count
from drape.motion.node_clip import MovingNodes, check_node_count, file_bytes, node_clip

RATES = (15.0, 120.0)  # A clip has the rate of its keys, within these limits.
ROUNDING_S = 1e-5  # A key that is later than a frame by less is at it: times are float32.
SPARSE_RATE = 30.0  # The rate of a clip whose keys are farther apart than at the lowest rate.
WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}


class ChannelTarget(Part):
    """What a channel animates: the ``path`` (translation, rotation, scale or weights) of a ``node``."""

    node: Index | None = None
    path: Text


class Channel(Part):
    """A channel of an animation: the index of its sampler, and what it animates."""

    sampler: Index
    target: ChannelTarget


class Sampler(Part):
    """The keys of a channel: the accessors ``input`` of their times [s] and ``output`` of their values.
    ``interpolation`` says how values lie between them."""

    input: Index
    output: Index
    interpolation: Text = "LINEAR"


class Animation(Part):
    """An animation of nodes: its channels, and their samplers."""

    name: Text = ""
    channels: Annotated[list[Channel], FIRST_ONLY]
    samplers: Annotated[list[Sampler], FIRST_ONLY]


Keys = tuple[np.ndarray, np.ndarray, str]  # Times (K,) [s], values (K, n) and how values lie between them.


def read_gltf_motion(path: Path, *, clip: str | None = None, most_frames: int | None = None) -> MotionClip:
    """Returns the animation called ``clip`` in a GLB, glTF, VRM or VRMA file, its longest if none is named, retargeted
    to the 24 SMPL joints.

    Nodes are joints by VRM's bones where the file has them, else by their names. Raises ``MotionError`` for a file
    without an animation of a person, and ``TooLarge`` for more than ``most_frames`` frames.
    """
    path = Path(path)
    try:
        file = GltfFile(
            file_bytes(path), label=path.name, beside=partial(file_beside, path.parent, most_bytes=FILE_BYTES)
        )
        animations = _animations(file, clip)
        tracks = max((_tracks(file, animation) for animation in animations), key=_length_s)
        return node_clip(_moving(file, tracks, most_frames), name=clip or path.stem)
    except (MotionError, TooLarge):
        raise
    except DrapeError as error:
        raise MotionError(error.name, expected=error.expected, got=error.got, cure=error.cure) from error


def _animations(file: GltfFile, clip: str | None) -> list[Animation]:
    """The animations of ``file``, or those called ``clip``."""
    held = file.document.animations
    try:
        animations = list(map(Animation.model_validate, held))
    except ValidationError as error:
        first = error.errors()[0]
        got, place = f"{first['msg']}", ".".join(map(str, first["loc"]))
        raise MotionError(
            f"{file.label}: animations.{place[:60]}", expected="a glTF animation", got=got, cure=EXPORT
        ) from error
    if clip is not None:
        names = ", ".join(repr(animation.name) for animation in animations[:40])
        animations = [animation for animation in animations if animation.name == clip]
        if not animations:
            raise MotionError(f"{file.label}: clip", expected=f"one of {names}", got=repr(clip)[:60], cure="Name one.")
    if not animations:
        raise MotionError(file.label, expected="an animation", got="none", cure="Export it with its animation.")
    return animations


Tracks = dict[tuple[int, str], Keys]


def _tracks(file: GltfFile, animation: Animation) -> Tracks:
    """The keys of each node and path that ``animation`` moves."""
    tracks: Tracks = {}
    for channel in animation.channels:
        width = WIDTHS.get(channel.target.path)
        if width is None or channel.target.node is None:  # Morph targets are not read, nor what extensions move.
            continue
        file.item("nodes", channel.target.node, "animation.channels.target")
        if channel.sampler >= len(animation.samplers):
            raise _fault(file, f"a sampler below {len(animation.samplers)}", str(channel.sampler))
        sampler = animation.samplers[channel.sampler]
        times, values = file.array(sampler.input)[:, 0].astype(float), file.array(sampler.output).astype(float)
        rows = len(times) * (3 if sampler.interpolation == "CUBICSPLINE" else 1)
        if values.shape != (rows, width) or (np.diff(times) < 0.0).any():
            got = f"{values.shape[0]} rows of {values.shape[1]} for {len(times)} keys"
            raise _fault(file, f"rising times and {rows} rows of {width}", got)
        tracks[channel.target.node, channel.target.path] = times, values, sampler.interpolation
    if not tracks:
        raise _fault(file, "nodes that move", f"none in {animation.name!r}")
    return tracks


def _fault(file: GltfFile, expected: str, got: str) -> MotionError:
    return MotionError(f"{file.label}: animation", expected=expected, got=got, cure=EXPORT)


def _length_s(tracks: Tracks) -> float:
    return max(float(times[-1] - times[0]) for times, _, _ in tracks.values())


def _moving(file: GltfFile, tracks: Tracks, most_frames: int | None) -> MovingNodes:
    """The nodes of ``file`` in the frames of ``tracks``."""
    order, parents = tree_of(file)
    nodes = [file.document.nodes[node] for node in order]
    times = _frame_times(file, tracks, len(order), most_frames)
    local = np.array([node_matrix(node) for node in nodes]).reshape(-1, 4, 4)
    scales = np.linalg.norm(local[:, :3, :3], axis=1)
    turns = matrix_to_quaternion(local[:, :3, :3] / np.maximum(scales, 1e-12)[:, None])
    parts = {"translation": local[:, :3, 3], "rotation": turns, "scale": scales}
    frames = {path: np.repeat(array[None], len(times), axis=0) for path, array in parts.items()}
    for place, node in enumerate(order):
        for path in WIDTHS:
            if (node, path) in tracks:
                frames[path][:, place] = _sampled(*tracks[node, path], times, turning=path == "rotation")
    bones = {node: bone for bone, node in file.document.extensions.humanoid.items()}
    plain = [node.name or f"node {number}" for number, node in zip(order, nodes, strict=True)]
    names = [bones.get(node, f"node {node}") for node in order] if bones else plain
    fps = (len(times) - 1) / max(times[-1] - times[0], 1e-9) if len(times) > 1 else SPARSE_RATE
    return MovingNodes(
        names, parents, world_matrices(local, parents), frames["translation"], frames["rotation"],
        np.maximum(frames["scale"], 1e-9), fps,
    )  # fmt: skip


def _frame_times(file: GltfFile, tracks: Tracks, nodes: int, most_frames: int | None) -> np.ndarray:
    """The times [s] of the clip's frames, at the rate of the keys."""
    keys = max((times for times, _, _ in tracks.values()), key=len)
    start, end = (end([edge for times, _, _ in tracks.values() for edge in times[[0, -1]]]) for end in (min, max))
    steps = np.diff(keys)
    step = float(np.median(steps[steps > 1e-6])) if (steps > 1e-6).any() else np.inf
    rate = SPARSE_RATE if 1.0 / step < RATES[0] else min(round(1.0 / step, 2), RATES[1])
    count = round((end - start) * rate) + 1
    check_frame_count(file.label, count, most_frames)
    check_node_count(count, nodes, file.label)
    return start + np.arange(count) / rate


def _sampled(keys: np.ndarray, values: np.ndarray, between: str, times: np.ndarray, *, turning: bool) -> np.ndarray:
    """The values (F, n) at ``times`` (F,); those of a node that is ``turning`` as unit quaternions wxyz."""
    last = len(keys) - 1
    low = np.clip(np.searchsorted(keys, times + ROUNDING_S, side="right") - 1, 0, max(last - 1, 0))
    high = np.minimum(low + 1, last)
    span = np.maximum(keys[high] - keys[low], 1e-9)
    share = np.clip((times - keys[low]) / span, 0.0, 1.0)
    if between == "STEP":
        low, share = np.where(share >= 1.0, high, low), np.zeros(len(times))
    if between == "CUBICSPLINE":
        found = _spline(values.reshape(len(keys), 3, -1), low, high, share, span)
        return _unit(found) if turning else found
    if turning:
        return quaternion_slerp(_unit(values[low]), _unit(values[high]), share)
    return values[low] + share[:, None] * (values[high] - values[low])


def _spline(keys: np.ndarray, low: np.ndarray, high: np.ndarray, share: np.ndarray, span: np.ndarray) -> np.ndarray:
    """Cubic Hermite splines through ``keys`` (K, 3, n): tangent in, value, tangent out (glTF 2.0, appendix C)."""
    t, span = share[:, None], span[:, None]
    square, cube = t * t, t * t * t
    found = (2.0 * cube - 3.0 * square + 1.0) * keys[low, 1] + (3.0 * square - 2.0 * cube) * keys[high, 1]
    return found + span * ((cube - 2.0 * square + t) * keys[low, 2] + (cube - square) * keys[high, 0])


def _unit(xyzw: np.ndarray) -> np.ndarray:
    """Unit quaternions (F, 4) wxyz; one without length turns nothing."""
    length = np.linalg.norm(xyzw, axis=1, keepdims=True)
    unit = np.where(length > 1e-9, xyzw / np.maximum(length, 1e-9), [0.0, 0.0, 0.0, 1.0])
    return np.roll(unit, 1, axis=1)
