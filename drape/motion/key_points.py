"""A person's key points in space, by name: MediaPipe's 33 landmarks, COCO's 17 points, or joints of a body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from drape.arrays import check_finite, check_shape
from drape.errors import MotionError
from drape.geometry.rotations import cross
from drape.motion.legs import SIDES

VISIBLE = 0.5
"""Visibility below which a point is not believed."""

# Points this close [m] have no direction, and lines this nearly parallel (sine) span no frame.
_LEAST_LENGTH_M = 1e-3
_LEAST_SINE = 1e-2


@dataclass(frozen=True)
class Layout:
    """Which of ``count`` points is which, by name, and the signs that turn their axes into ours."""

    index: Mapping[str, int]
    count: int
    signs: tuple[float, float, float] = (1.0, 1.0, 1.0)


def _of_both_sides(left: Mapping[str, int]) -> dict[str, int]:
    """Indices by name, where the right side's point follows the left side's."""
    return {f"{side}_{name}": at + k for name, at in left.items() for k, side in enumerate(SIDES)}


LAYOUTS = {
    # World landmarks: x as in the picture, y down, z away from the camera.
    "mediapipe": Layout(
        {"nose": 0}
        | _of_both_sides({"ear": 7, "shoulder": 11, "elbow": 13, "wrist": 15})
        | _of_both_sides({"hip": 23, "knee": 25, "ankle": 27, "heel": 29, "toe": 31}),
        count=33,
        signs=(1.0, -1.0, -1.0),
    ),
    # COCO defines no axes in space: they are taken for ours.
    "coco": Layout(
        {"nose": 0}
        | _of_both_sides({"ear": 3, "shoulder": 5, "elbow": 7, "wrist": 9, "hip": 11, "knee": 13, "ankle": 15}),
        count=17,
    ),
}


def layout_named(name: str) -> Layout:
    """The layout of ``LAYOUTS``; another name is refused."""
    if name not in LAYOUTS:
        raise MotionError(
            "layout", expected=" or ".join(map(repr, LAYOUTS)), got=repr(name), cure="Name the order of the points."
        )
    return LAYOUTS[name]


@dataclass(frozen=True, eq=False)
class KeyPoints:
    """Points (F, N, 3) [m] in our axes, whether each is seen (F, N), and their layout."""

    places: np.ndarray
    seen: np.ndarray
    layout: Layout
    label: str = "landmarks"

    @classmethod
    def checked(cls, points: np.ndarray, visibility: np.ndarray | None, layout: Layout) -> KeyPoints:
        """Points (F, N, 3) in the layout's axes; raises ``MotionError`` for another shape or NaN, seen or not.

        Without ``visibility`` (F, N) all are seen.
        """
        points = np.asarray(points, dtype=np.float64)
        check_shape("landmarks", points, (None, layout.count, 3), error=MotionError)
        check_finite("landmarks", points, error=MotionError)
        seen = np.ones(points.shape[:2], dtype=bool)
        if visibility is not None:
            visibility = np.asarray(visibility, dtype=np.float64)
            check_shape("visibility", visibility, seen.shape, error=MotionError)
            check_finite("visibility", visibility, error=MotionError)
            seen = visibility >= VISIBLE
        return cls(points * layout.signs, seen, layout)

    def __len__(self) -> int:
        return len(self.places)

    def has(self, name: str) -> bool:
        """Whether the layout has such a point."""
        return name in self.layout.index

    def sees(self, *names: str) -> np.ndarray:
        """In which frames (F,) all points named are seen."""
        return np.all(self.seen[:, self._at(names)], axis=1)

    def lines_seen(self, starts: Sequence[str], ends: Sequence[str]) -> np.ndarray:
        """Whether both ends of each line are seen (F, n)."""
        return self.seen[:, self._at(starts)] & self.seen[:, self._at(ends)]

    def lines(self, starts: Sequence[str], ends: Sequence[str]) -> np.ndarray:
        """Unit vectors (F, n, 3) from each start to its end; refused where both are seen at one place."""
        lines = self.places[:, self._at(ends)] - self.places[:, self._at(starts)]
        lengths = np.linalg.norm(lines, axis=-1, keepdims=True)
        close = lengths < _LEAST_LENGTH_M
        bad = close[..., 0] & self.lines_seen(starts, ends)
        if bad.any():
            line = int(bad.any(axis=0).argmax())
            self._refuse(bad[:, line], f"{starts[line]} and {ends[line]} apart", "one place")
        return lines / np.where(close, 1.0, lengths)

    def with_middles(self, **names: tuple[str, ...]) -> KeyPoints:
        """Returns these points and the middles of some of them, under names of their own. A middle is seen where all of
        its points are."""
        places = [self.places[:, self._at(parts)].mean(axis=1) for parts in names.values()]
        seen = [self.sees(*parts) for parts in names.values()]
        index = dict(self.layout.index) | {name: self.layout.count + k for k, name in enumerate(names)}
        return KeyPoints(
            np.concatenate([self.places, np.stack(places, axis=1)], axis=1),
            np.concatenate([self.seen, np.stack(seen, axis=1)], axis=1),
            Layout(index, self.layout.count + len(names)),
            self.label,
        )

    def frame(self, left: np.ndarray, ahead: np.ndarray, *, of: tuple[str, ...]) -> np.ndarray:
        """Rotations (F, 3, 3) with x along unit ``left`` (F, 3) and z in the half plane of ``ahead`` (F, 3).

        ``ahead`` is of length one at most, and its part across ``left`` is the sine of what
        they span: refused where the points ``of`` are seen and span next to nothing.
        """
        across = ahead - np.sum(left * ahead, axis=-1, keepdims=True) * left
        sine = np.linalg.norm(across, axis=-1, keepdims=True)
        flat = sine < _LEAST_SINE
        bad = flat[:, 0] & self.sees(*of)
        if bad.any():
            self._refuse(bad, f"{', '.join(of)} off one line", "all on a line")
        forward = across / np.where(flat, 1.0, sine)
        return np.stack([left, cross(forward, left), forward], axis=-1)

    def _at(self, names: Sequence[str]) -> list[int]:
        return [self.layout.index[name] for name in names]

    def _refuse(self, bad: np.ndarray, expected: str, got: str) -> NoReturn:
        raise MotionError(
            f"{self.label} of frame {int(bad.argmax())}",
            expected=expected,
            got=got,
            cure="Give points that were not found a visibility of 0; give a body all its joints.",
        )
