"""The batch that stages hand on: posed inputs of several clients and frames, checked, and results so far."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np

from drape.body.model import BodyModel
from drape.errors import BodyError, MotionError, TooLarge
from drape.network.card_memory import to_processor
from drape.stages.placing import Origin, Placed
from drape.stages.plan import Plan

Memories = Mapping[tuple[str, str], Any]  # by stage and owner; values are never changed in place
Steps = tuple[np.ndarray, np.ndarray, np.ndarray]  # (V, 3) uint16, low corner and step size (3,)
Record = TypeVar("Record", "Batch", "Layer", "Quality")

# Beyond these the numbers are a mistake of unit, and squares overflow.
ANGLE_LIMIT_RAD = 1000.0
PLACE_LIMIT_M = 1e6
BETA_LIMIT = 20.0
# Angles of so many joints beyond two whole turns, and of none beyond what a rotation in degrees has, are degrees.
DEGREES_JOINTS, DEGREES_BEYOND_RAD, MOST_DEGREES = 4, 4.0 * np.pi, 360.0
PLAIN_RAD = 7.0  # no rotation vector of such coordinates or smaller ones goes beyond two whole turns


@dataclass(frozen=True, eq=False)
class PoseInput:
    """Checked poses (F, 24, 3) [rad], translations (F, 3) [m] and the shape (S,) of one client's body.

    ``times_s`` (F,): the frames' times [s] by the client's clock. ``memories``: what the stages keep of the frames
    before. ``sequence``: the number of the first frame. ``dropped``: poses of the stream that newer ones replaced;
    ``arrived_s`` [s]: when the pose came, by a monotonic clock, None where nobody waits; both go into the message's
    header. ``shown``: the message of the frame that the client shows now; None if the client does not take the word
    that it still holds (SAME).
    """

    poses: np.ndarray
    trans: np.ndarray
    betas: np.ndarray
    times_s: np.ndarray
    memories: Memories = field(default_factory=dict)
    sequence: int = 0
    dropped: int = 0
    arrived_s: float | None = None
    shown: bytes | None = None

    def part(self, rows: slice, memories: Memories) -> PoseInput:
        """The frames ``rows`` of this input, which go on from ``memories``."""
        return replace(
            self,
            poses=self.poses[rows],
            trans=self.trans[rows],
            times_s=self.times_s[rows],
            memories=memories,
            sequence=self.sequence + rows.start,
        )


def check_poses(poses: np.ndarray, trans: np.ndarray) -> None:
    """Refuses rotation vectors (F, 24, 3) [rad] beyond ``ANGLE_LIMIT_RAD`` or that look like degrees, and translations
    (F, 3) [m] that are too far away. Numbers are finite."""
    if len(poses) and np.abs(poses).max() <= PLAIN_RAD:  # nearly all: the checks that name what is wrong take longer
        check_places(trans)
        return
    _check_limit("poses", poses, ANGLE_LIMIT_RAD, "rad", "Send rotation vectors in radians.")
    _check_unit(poses)
    check_places(trans)


def _check_unit(poses: np.ndarray) -> None:
    """Refuses poses (F, 24, 3) whose numbers are those of degrees: no joint of a person turns twice around, several do
    so at once, and none by more than degrees go."""
    angles = np.linalg.norm(poses, axis=-1).max(axis=0, initial=0.0)
    turning = angles[angles > DEGREES_BEYOND_RAD]
    if len(turning) >= DEGREES_JOINTS and angles.max() <= MOST_DEGREES:
        got = f"up to {angles.max():.4g} on {len(turning)} joints: these look like degrees"
        cure = "Send radians: multiply by pi / 180."
        raise MotionError("poses", expected="rotation vectors in radians", got=got, cure=cure)


def check_places(trans: np.ndarray) -> None:
    """Refuses translations (F, 3) [m] that are finite but senseless."""
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
    """Checked shape coefficients (S,), zeros where none were sent; refuses any for an avatar."""
    if betas and body.standard_digest:
        raise BodyError("betas", expected="none: an avatar has its own shape", got="some", cure="Leave them out.")
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


@dataclass(frozen=True, eq=False)
class Jets:
    """Posed patches of F frames: ``jet`` (F, K, 45), ``rotation`` (F, K, 3, 3) and ``centre`` [m] (F, K, 3) float32."""

    jet: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray


@dataclass(frozen=True, eq=False)
class Layer:
    """All frames of one garment relative to the roots: vertices [m] (F, V, 3) float32 or jets or both, as needed."""

    vertices: np.ndarray | None = None
    jets: Jets | None = None


@dataclass(frozen=True, eq=False)
class Quality:
    """Figures of each frame (F,).

    ``pushed_share`` of the vertices were moved off the skin by the collision projection or by folds, the furthest by
    ``push_max_m`` [m]. A vertex made of the jets lacks at most ``left_m`` [m] of that. ``folds_resets`` layers began
    their folds anew. ``novelty`` says how unlike training the pose is; above 1 it is outside (``body.pose_distance``).
    """

    pushed_share: np.ndarray
    push_max_m: np.ndarray
    left_m: np.ndarray
    folds_resets: np.ndarray
    novelty: np.ndarray

    @staticmethod
    def untouched(frames: int) -> Quality:
        none = np.zeros(frames)  # of all: arrays are never changed in place
        return Quality(none, none, none, none, none)


@dataclass(frozen=True, eq=False)
class Batch:
    """Frames of several clients under one plan, one input's after the other, and what the stages have made so far.

    ``memories``: those of each input, after its frames. ``codes`` (F, C): the codes of moving bodies. ``skin`` (F, R,
    12, 8): the posed skin samples, where a stage needs them. ``layers``: the garments, the innermost first. ``root``
    [m] (F, 3) float64: the places of the root joints. ``messages``: the frames' messages. ``steps``: each frame's
    vertices in steps of their box, where the engine has made these (``drape.wire.quantised``).
    """

    plan: Plan
    inputs: tuple[PoseInput, ...]
    memories: tuple[Memories, ...]
    quality: Quality
    codes: np.ndarray | None = None
    skin: np.ndarray | None = None
    layers: tuple[Layer, ...] = ()
    root: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    messages: tuple[bytes, ...] = ()
    steps: tuple[Steps, ...] = ()

    @staticmethod
    def of(plan: Plan, inputs: Sequence[PoseInput]) -> Batch:
        """The batch before its first stage."""
        frames = sum(len(one.poses) for one in inputs)
        return Batch(plan, tuple(inputs), tuple(one.memories for one in inputs), Quality.untouched(frames))

    @staticmethod
    def of_parts(clip: PoseInput, parts: Sequence[Batch]) -> Batch:
        """The batch of ``clip``, joined from the batches of its parts."""
        if len(parts) == 1:
            return parts[0]
        layers = [_whole(together) for together in zip(*(part.layers for part in parts), strict=True)]
        return replace(
            parts[-1],
            inputs=(clip,),
            quality=_whole([part.quality for part in parts]),
            layers=tuple(layers),
            root=np.concatenate([part.root for part in parts]),
            messages=tuple(message for part in parts for message in part.messages),
        )

    def answer(self) -> Batch:
        """The batch without the arrays that only stages read, and without hidden layers."""
        of = zip(self.layers, self.plan.visible, strict=bool(self.layers))  # none before the network
        return changed(
            self, codes=None, skin=None, steps=(), layers=tuple(layer if seen else Layer() for layer, seen in of)
        )

    @property
    def count(self) -> int:
        """The number of frames."""
        return len(self.quality.novelty)

    def rows(self) -> Iterator[tuple[PoseInput, slice]]:
        """Each input, with the rows that its frames have in the batch."""
        start = 0
        for one in self.inputs:
            yield one, slice(start, start + len(one.poses))
            start += len(one.poses)

    def remembered(self, key: tuple[str, str]) -> list[Any]:
        """The memory of each input under ``key``, from a card if it is there; None for an input that has none."""
        return [to_processor(memories.get(key)) for memories in self.memories]

    def remember(self, key: tuple[str, str], values: Sequence[Any]) -> Batch:
        """The batch with ``values``, one for each input, stored in the memories under ``key``."""
        after = ({**memories, key: value} for memories, value in zip(self.memories, values, strict=True))
        return changed(self, memories=tuple(after))

    @property
    def shown(self) -> list[Layer]:
        """The layers that the answer holds."""
        return [layer for layer, seen in zip(self.layers, self.plan.visible, strict=True) if seen]

    @property
    def vertices(self) -> np.ndarray:
        """The vertices [m] (F, V, 3) of the visible layers, one layer after the other, relative to the root."""
        return concatenated([layer.vertices for layer in self.shown])

    @property
    def jets(self) -> Jets:
        """The posed patches of the visible layers, one layer after the other."""
        jets = [layer.jets for layer in self.shown if layer.jets is not None]
        return Jets(*(concatenated([getattr(one, name) for one in jets]) for name in ("jet", "rotation", "centre")))

    def placed(self, origin: Origin) -> Placed:
        """Returns the vertices of the answer: from the world's origin, or relative to the root and with the roots,
        as ``origin`` says."""
        return Placed(self.world()) if origin == "world" else Placed(self.vertices, self.root)

    def world(self) -> np.ndarray:
        """The vertices [m] (F, V, 3) in the world, float32."""
        return (self.vertices + self.root[:, None, :]).astype(np.float32)


def changed(record: Record, **values: Any) -> Record:
    """Returns ``record`` with other ``values``, as ``dataclasses.replace`` does but in a tenth of its time. It is for
    records without slots that check nothing when made.
    """
    made = object.__new__(type(record))
    vars(made).update(vars(record), **values)
    return made


def stacked(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Returns ``arrays`` of frames as one (F, ...); the array of a single frame is not copied."""
    return arrays[0][None] if len(arrays) == 1 else np.stack(arrays)


def concatenated(parts: Sequence[np.ndarray | None], axis: int = 1) -> np.ndarray:
    """Joins ``parts`` along ``axis``, without those that are None. If one is left, it is returned as it is."""
    arrays = [part for part in parts if part is not None]
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays, axis=axis)


def _whole(parts: Sequence[Any]) -> Any:
    """``parts`` of one kind, with arrays of frames, one after the other."""
    if parts[0] is None:
        return None
    if isinstance(parts[0], np.ndarray):
        return np.concatenate(parts)
    names = [item.name for item in fields(parts[0])]
    return type(parts[0])(**{name: _whole([getattr(part, name) for part in parts]) for name in names})
