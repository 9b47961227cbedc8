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
    header. ``shown``: the message that the client shows now; None if it takes no SAME messages.
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
        """Returns the frames ``rows`` of this input, with ``memories`` of the frames before them."""
        return replace(
            self,
            poses=self.poses[rows],
            trans=self.trans[rows],
            times_s=self.times_s[rows],
            memories=memories,
            sequence=self.sequence + rows.start,
        )


def check_poses(poses: np.ndarray, trans: np.ndarray) -> None:
    """Refuses (``MotionError``) rotation vectors (F, 24, 3) [rad] beyond ``ANGLE_LIMIT_RAD`` or that look like degrees,
    translations (F, 3) [m] beyond ``PLACE_LIMIT_M``, and NaN."""
    if len(poses) and np.abs(poses).max() <= PLAIN_RAD:  # nearly all: the checks that name what is wrong take longer
        check_places(trans)
        return
    _check_limit("poses", poses, ANGLE_LIMIT_RAD, "rad", "Send rotation vectors in radians.")
    _check_unit(poses)
    check_places(trans)


def _check_unit(poses: np.ndarray) -> None:
    """Refuses poses (F, 24, 3) that look like degrees: several joints turn more than twice around, which no person's
    do, and no number is above ``MOST_DEGREES``."""
    angles = np.linalg.norm(poses, axis=-1).max(axis=0, initial=0.0)
    turning = angles[angles > DEGREES_BEYOND_RAD]
    if len(turning) >= DEGREES_JOINTS and angles.max() <= MOST_DEGREES:
        got = f"up to {angles.max():.4g} on {len(turning)} joints: these look like degrees"
        cure = "Send radians: multiply by pi / 180."
        raise MotionError("poses", expected="rotation vectors in radians", got=got, cure=cure)


def check_places(trans: np.ndarray) -> None:
    """Refuses (``MotionError``) translations (F, 3) [m] beyond ``PLACE_LIMIT_M``, and NaN."""
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
    """Returns poses (F, 24, 3) [rad] and translations (F, 3) [m], float64; without ``trans`` these are zeros.

    Refuses (``MotionError``) no frames, another number of translations, and what ``check_poses`` refuses; and
    (``TooLarge``) more than ``max_frames`` frames.
    """
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
    """Returns the shape coefficients (S,) float64 of ``body`` [standard deviations], zeros where ``betas`` has none.

    Refuses (``BodyError``) too many, numbers beyond ``BETA_LIMIT``, and any for an avatar.
    """
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
    """Posed patches of F frames, float32. ``jet`` (F, K, 45) [patch scales] are the coefficients of the change of each
    patch's rest surface; ``rotation`` (F, K, 3, 3) and ``centre`` [m] (F, K, 3), relative to the root, are the patches'
    frames."""

    jet: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray


@dataclass(frozen=True, eq=False)
class Layer:
    """One garment in all frames, relative to the roots: ``vertices`` [m] (F, V, 3) float32, ``jets``, or both; None is
    what the plan does not need."""

    vertices: np.ndarray | None = None
    jets: Jets | None = None


@dataclass(frozen=True, eq=False)
class Quality:
    """Figures of each frame, all (F,).

    ``pushed_share`` is the share of the visible vertices that the collision projection or folds moved off the skin, and
    ``push_max_m`` [m] is how far at most. Vertices that a client makes of pushed jets are short of clear by ``left_m``
    [m] at most. ``folds_resets`` is the number of layers that began their folds anew. ``novelty`` says how unlike
    training the pose is; a pose above 1 is novel (``body.pose_distance``).
    """

    pushed_share: np.ndarray
    push_max_m: np.ndarray
    left_m: np.ndarray
    folds_resets: np.ndarray
    novelty: np.ndarray

    @staticmethod
    def untouched(frames: int) -> Quality:
        none = np.zeros(frames)  # one for all figures, since arrays are never changed in place
        return Quality(none, none, none, none, none)


@dataclass(frozen=True, eq=False)
class Batch:
    """Frames of several clients under one plan, one input's after the other, and what the stages have made so far.

    ``memories``: those of each input, after its frames. ``codes`` (F, C): the codes of motion, None without. ``skin``
    (F, R, 12, 8): the posed skin samples, where a stage needs them. ``layers``: the garments, the innermost first.
    ``root`` [m] (F, 3) float64: the places of the root joints. ``messages``: the frames' messages. ``steps``: each
    frame's vertices as ``drape.wire.quantised.quantise`` returns them, where the engine has made these.
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
        """Returns the batch of ``inputs`` before its first stage."""
        frames = sum(len(client.poses) for client in inputs)
        return Batch(plan, tuple(inputs), tuple(client.memories for client in inputs), Quality.untouched(frames))

    @staticmethod
    def of_parts(clip: PoseInput, parts: Sequence[Batch]) -> Batch:
        """Returns the batch of ``clip``, joined of the batches of its ``parts`` in their order. Codes, skin and steps
        are those of the last part. A single part is returned as it is."""
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
        """Returns the batch as an answer needs it: without codes, skin and steps, and with empty hidden layers."""
        both = zip(self.layers, self.plan.visible, strict=bool(self.layers))  # there are no layers before the network
        layers = tuple(layer if visible else Layer() for layer, visible in both)
        return changed(self, codes=None, skin=None, steps=(), layers=layers)

    @property
    def count(self) -> int:
        """Returns the number of frames of all inputs."""
        return len(self.quality.novelty)

    def rows(self) -> Iterator[tuple[PoseInput, slice]]:
        """Yields each input with the slice of its frames among those of the batch."""
        start = 0
        for client in self.inputs:
            yield client, slice(start, start + len(client.poses))
            start += len(client.poses)

    def remembered(self, key: tuple[str, str]) -> list[Any]:
        """Returns the memory of each input under ``key``, fetched from a card if it lies there; None where there is
        none."""
        return [to_processor(memories.get(key)) for memories in self.memories]

    def remember(self, key: tuple[str, str], values: Sequence[Any]) -> Batch:
        """Returns the batch with ``values``, one for each input, in the memories under ``key``."""
        after = ({**memories, key: value} for memories, value in zip(self.memories, values, strict=True))
        return changed(self, memories=tuple(after))

    @property
    def shown(self) -> list[Layer]:
        """Returns the visible layers, the innermost first."""
        return [layer for layer, seen in zip(self.layers, self.plan.visible, strict=True) if seen]

    @property
    def vertices(self) -> np.ndarray:
        """Returns the vertices [m] (F, V, 3) of the visible layers, one layer after the other, relative to the
        roots."""
        return concatenated([layer.vertices for layer in self.shown])

    @property
    def jets(self) -> Jets:
        """Returns the posed patches of the visible layers, one layer after the other."""
        jets = [layer.jets for layer in self.shown if layer.jets is not None]
        return Jets(*(concatenated([getattr(own, name) for own in jets]) for name in ("jet", "rotation", "centre")))

    def placed(self, origin: Origin) -> Placed:
        """Returns the vertices of the visible layers, counted from the world's origin or from the roots, as ``origin``
        says."""
        return Placed(self.world()) if origin == "world" else Placed(self.vertices, self.root)

    def world(self) -> np.ndarray:
        """Returns the vertices [m] (F, V, 3) of the visible layers in the world, float32."""
        return (self.vertices + self.root[:, None, :]).astype(np.float32)


def changed(record: Record, **values: Any) -> Record:
    """Returns a copy of ``record`` with other ``values``, as ``dataclasses.replace`` does but in a tenth of its time.
    It is for records without slots that check nothing when made."""
    copy = object.__new__(type(record))
    vars(copy).update(vars(record), **values)
    return copy


def stacked(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Returns the ``arrays`` of F frames as one (F, ...); that of a single frame is not copied."""
    return arrays[0][None] if len(arrays) == 1 else np.stack(arrays)


def concatenated(parts: Sequence[np.ndarray | None], axis: int = 1) -> np.ndarray:
    """Returns ``parts`` joined along ``axis``, without those that are None. A single one is returned as it is."""
    arrays = [part for part in parts if part is not None]
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays, axis=axis)


def _whole(parts: Sequence[Any]) -> Any:
    """One value of all ``parts``: arrays, or dataclasses of arrays, joined along their frames; None if they are
    None."""
    if parts[0] is None:
        return None
    if isinstance(parts[0], np.ndarray):
        return np.concatenate(parts)
    names = [item.name for item in fields(parts[0])]
    return type(parts[0])(**{name: _whole([getattr(part, name) for part in parts]) for name in names})
