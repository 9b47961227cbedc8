"""The One Euro filter: little jitter while points rest, little lag while they move.

Casiez, Roussel, Vogel: 1 € Filter, a simple speed-based low-pass filter for noisy input
in interactive systems (CHI 2012). A first-order low pass whose cut-off frequency grows
with speed: ``f_c = minCutoff + beta |v|``, and ``v`` itself is smoothed at ``dCutoff``.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from drape.arrays import check_finite, check_shape
from drape.errors import MotionError


@dataclass(eq=False)
class OneEuro:
    """A filter of points (..., n) in a stream; it remembers the last sample.

    ``min_cutoff`` and ``d_cutoff`` are frequencies [Hz]. ``beta`` [Hz per unit of speed]
    is 0 for a plain low pass; what suits pixels does not suit metres. Speed is the length
    of the last axis, so that a turned point is filtered to the turned result; numbers
    that have nothing to do with each other are passed as (..., 1).
    """

    min_cutoff: float = 1.0
    beta: float = 0.0
    d_cutoff: float = 1.0
    _last: np.ndarray | None = field(default=None, init=False, repr=False)
    _velocity: np.ndarray = field(default_factory=lambda: np.zeros(0), init=False, repr=False)
    _seen: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool), init=False, repr=False)

    def __post_init__(self) -> None:
        for name, value, least in (
            ("min_cutoff", self.min_cutoff, "positive"),
            ("beta", self.beta, "zero or positive"),
            ("d_cutoff", self.d_cutoff, "positive"),
        ):
            if not np.isfinite(value) or value < 0.0 or (value == 0.0 and least == "positive"):
                raise MotionError(
                    name,
                    expected=f"a {least} number",
                    got=str(value),
                    cure="Begin with min_cutoff=1.0, beta=0.0, d_cutoff=1.0; raise beta until motion no longer lags.",
                )

    def __call__(self, points: np.ndarray, dt_s: float, *, seen: np.ndarray | None = None) -> np.ndarray:
        """The filtered points (..., n); ``dt_s`` is the time since the last sample, unused for the first.

        A point that is not seen (...,) now, or was not in the last sample, comes out as it is.
        """
        points = np.array(points, dtype=np.float64)
        check_finite("points", points, error=MotionError)
        seen = np.ones(points.shape[:-1], dtype=bool) if seen is None else np.array(seen, dtype=bool)
        check_shape("seen", seen, points.shape[:-1], error=MotionError)
        if self._last is None:
            self._last, self._velocity, self._seen = points, np.zeros_like(points), seen
            return points.copy()
        check_shape("points", points, self._last.shape, error=MotionError)
        if not (np.isfinite(dt_s) and dt_s > 0.0):
            raise MotionError(
                "dt_s", expected="a positive time step [s]", got=str(dt_s), cure="Pass samples in the order of time."
            )
        known = (seen & self._seen)[..., None]
        ahead = points - self._last
        velocity = self._velocity + smoothing(self.d_cutoff, dt_s) * (ahead / dt_s - self._velocity)
        speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
        smooth = self._last + smoothing(self.min_cutoff + self.beta * speed, dt_s) * ahead
        self._velocity = np.where(known, velocity, 0.0)
        self._last, self._seen = np.where(known, smooth, points), seen
        return self._last.copy()

    def reset(self) -> None:
        """Forgets the last sample: the next one starts a stream."""
        self._last = None


def one_euro(
    points: np.ndarray, *, fps: float, min_cutoff: float = 1.0, beta: float = 0.0, d_cutoff: float = 1.0
) -> np.ndarray:
    """Returns ``points`` (F, ..., n), taken at ``fps`` [1/s], filtered: each one by those before it."""
    if not (np.isfinite(fps) and fps > 0.0):
        raise MotionError(
            "fps", expected="a positive frame rate [1/s]", got=str(fps), cure="Pass the clip's frames per second."
        )
    stream = OneEuro(min_cutoff=min_cutoff, beta=beta, d_cutoff=d_cutoff)
    filtered = np.array(points, dtype=np.float64)
    for frame, sample in enumerate(filtered):
        filtered[frame] = stream(sample, 1.0 / fps)
    return filtered


def smoothing(cutoff_hz: float | np.ndarray, dt_s: float) -> float | np.ndarray:
    """Share of a new sample in the result: ``1 / (1 + tau / dt)`` with ``tau = 1 / (2 pi f_c)``."""
    rate = 2.0 * np.pi * cutoff_hz * dt_s
    return rate / (rate + 1.0)
