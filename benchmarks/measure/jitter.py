"""Jitter: how much rougher in time a drape moves than plain skinning, over continuous windows of clips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.cases import pushed, skinned
from benchmarks.model_drape import ModelDrape
from drape.body.model import BodyModel
from drape.cloth.metrics import third_difference_square
from drape.contact.projection import push_out_of_bodies
from drape.contact.skin import body_skin
from drape.garment.cache import Garment
from drape.graph.push_feed import push_feed
from drape.motion.clip import MotionClip, clean_windows, joint_steps

FPS = 60.0
WINDOW = 60  # frames of a window
STRIDE = 15


@dataclass(frozen=True, eq=False)
class Window:
    """Consecutive ``poses`` (F, 24, 3) [rad] of a clip; ``label`` "clip:first-last"."""

    poses: np.ndarray
    label: str


@dataclass(frozen=True)
class Jitter:
    """How much rougher than plain skinning a drape moves: the RMS of its third difference in time over that of
    skinning, NaN where skinning stands still.

    ``ratio`` is over all windows together, ``by_clip`` over each alone, by the window's label.
    """

    ratio: float
    by_clip: dict[str, float]

    @property
    def worst(self) -> float:
        """The largest ratio of one window; NaN where skinning moves in none."""
        return max((ratio for ratio in self.by_clip.values() if np.isfinite(ratio)), default=float("nan"))


def typical_windows(clips: Sequence[MotionClip], *, length: int = WINDOW) -> list[Window]:
    """Returns one window for every clip: of all its windows of ``length`` frames without a glitch, that in which joints
    turn by the median amount. A clip without any has none.

    Clips faster than 60 frames per second are resampled to that; a slower one is taken as it is, since interpolated
    frames would put corners into its motion.
    """
    windows = []
    for clip in clips:
        paced = clip.resampled(FPS) if clip.fps > FPS else clip
        starts = np.array(clean_windows(paced, length, stride=STRIDE), dtype=np.int64)
        if len(starts) == 0:
            continue
        turned = np.concatenate([[0.0], np.cumsum(joint_steps(paced).sum(axis=1))])
        order = np.argsort(turned[starts + length - 1] - turned[starts], kind="stable")
        start = int(starts[order[len(order) // 2]])
        label = f"{paced.name}:{start}-{start + length - 1}"
        windows.append(Window(paced.poses[start : start + length], label))
    return windows


def jitter(garment: Garment, network: ModelDrape, body: BodyModel, windows: Sequence[Window]) -> dict[str, Jitter]:
    """Returns the jitter of ``garment`` over ``windows`` by method: "skinning" (1 by definition), "network", and both
    with push-out, "skinning_push" and "network_push". Empty where there are no windows.

    The root stays in its place; its way would add the same to all.
    """
    if not windows:
        return {}
    squares: dict[str, list[float]] = {"skinning": [], "skinning_push": [], "network": [], "network_push": []}
    feed = push_feed(garment, body)
    for window in windows:
        plain = skinned(garment, body, window.poses)
        draped, posed = network.drape(garment, window.poses).vertices, body.posed_vertices(window.poses)
        drapes = {
            "skinning": plain,
            "skinning_push": pushed(plain, body, window.poses),
            "network": draped,
            "network_push": push_out_of_bodies(draped, posed, body_skin(body), feed),
        }
        for method, vertices in drapes.items():
            squares[method].append(third_difference_square(vertices))
    labels = [window.label for window in windows]
    return {method: _compared(values, squares["skinning"], labels) for method, values in squares.items()}


def _compared(squares: Sequence[float], skinning: Sequence[float], labels: Sequence[str]) -> Jitter:
    single = [_ratio(own, base) for own, base in zip(squares, skinning, strict=True)]
    return Jitter(_ratio(sum(squares), sum(skinning)), dict(zip(labels, single, strict=True)))


def _ratio(square: float, base: float) -> float:
    return float(np.sqrt(square / base)) if base > 0.0 else float("nan")
