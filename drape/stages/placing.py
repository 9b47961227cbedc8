"""The point that positions of an answer count from: the world's origin, or each frame's root, sent beside them.

A float32 of 1e4 m has steps of 1 mm, one of 1e6 m of 62 mm: far from the origin only what counts from the root keeps
the shape of a garment. A stream's frames always count from the root (docs/reference/wire.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

Origin = Literal["world", "root"]


@dataclass(frozen=True, eq=False)
class Placed:
    """``vertices`` [m] (F, V, 3) float32 in the world's axes, counted from each frame's root in ``roots`` [m] (F, 3)
    float64, or from the world's origin where these are None."""

    vertices: np.ndarray
    roots: np.ndarray | None = None

    @property
    def origin(self) -> Origin:
        return "world" if self.roots is None else "root"

    @property
    def rounding_m(self) -> float:
        """Returns the most [m] by which rounding to float32 moves a coordinate: half a step of the largest one."""
        return 0.5 * float(np.spacing(np.abs(self.vertices).max(initial=0.0)))

    @property
    def headers(self) -> dict[str, str]:
        """Returns the HTTP headers of an answer: numbers of frames and vertices, origin, and rounding [m]."""
        return {
            "X-Drape-Frames": str(len(self.vertices)),
            "X-Drape-Vertices": str(self.vertices.shape[1]),
            "X-Drape-Origin": self.origin,
            "X-Drape-Rounding-M": f"{self.rounding_m:.3g}",
        }

    @property
    def tail(self) -> bytes:
        """Returns the bytes after the vertices in a binary answer: the roots as little-endian float64, none without."""
        return b"" if self.roots is None else self.roots.astype("<f8").tobytes()

    def counted_from(self, root: np.ndarray) -> Placed:
        """Returns the vertices counted from ``root`` [m] (3,) in all frames; those without ``roots`` stay as they
        are."""
        if self.roots is None:
            return self
        return Placed((self.vertices + (self.roots - root)[:, None]).astype(np.float32))

    def from_first(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns the vertices [m] (F, V, 3) counted from one point for all frames, and this point [m] (3,): the first
        root, or the world's origin without ``roots``."""
        if self.roots is None:
            return self.vertices, np.zeros(3)
        return self.vertices + (self.roots - self.roots[0])[:, None], self.roots[0]
