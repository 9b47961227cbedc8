"""The hem of a garment, and how low it hangs."""

from __future__ import annotations

import numpy as np

from benchmarks.tables import Row
from drape.geometry import meshes

HEM_SHARE = 0.1  # a boundary is a hem in this share of the garment's height, from below
SETTLED_M = 0.005  # a hem nearer to its place is at rest


def hem_vertices(rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns the indices (n,) of the boundary vertices in the lowest tenth of the height of a garment with vertices
    ``rest`` [m] (V, 3): of trousers those of both legs. Empty where the mesh has no border."""
    border = np.unique(np.concatenate([np.zeros(0, np.int64), *meshes.boundary_loops(faces)]))
    low, high = rest[:, 1].min(), rest[:, 1].max()
    return border[rest[border, 1] <= low + HEM_SHARE * (high - low)]


def hang_mm(vertices: np.ndarray, skinned: np.ndarray, rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns how much lower [mm] (F,) the hem of ``vertices`` [m] (F, V, 3) is than that of the ``skinned`` garment
    [m] (F, V, 3), on average along the hem; NaN where there is no hem.

    Every vertex counts by half of the length at rest of its border edges that lie in the hem. The same cut hangs lower
    in a cloth that stretches more.
    """
    hem = hem_vertices(rest, faces)
    length_m = np.zeros(len(rest))
    for loop in meshes.boundary_loops(faces):
        after = np.roll(loop, -1)
        inside = np.isin(loop, hem) & np.isin(after, hem)
        half = 0.5 * np.linalg.norm(rest[after] - rest[loop], axis=1) * inside
        np.add.at(length_m, loop, half)
        np.add.at(length_m, after, half)
    if not length_m.any():
        return np.full(len(vertices), np.nan)
    lower_m = skinned[:, hem, 1].astype(np.float64) - vertices[:, hem, 1]
    return 1e3 * lower_m @ length_m[hem] / length_m[hem].sum()


def swinging(parts: np.ndarray, fps: float) -> Row:
    """Returns how the ``parts`` of a hem, at places [m] (F, P, 3), come to rest on a body that stands still.

    ``settle_s`` is the time after which they stay within ``SETTLED_M`` (RMS) of their last places. The other two are
    measured along the direction in which they move most; a swing lasts from one pass through the last place to the
    next. ``over`` is the height of the swing after the largest one, over that of the largest. ``period_s`` is twice the
    time of the swing after the largest. Both are NaN where nothing swings by more than ``SETTLED_M``, and ``period_s``
    also where that swing does not end.
    """
    off = parts - parts[-1]
    far = np.flatnonzero(np.sqrt((off**2).sum(axis=2).mean(axis=1)) > SETTLED_M)
    flat = off.reshape(len(off), -1) / np.sqrt(off.shape[1])
    along = flat @ np.linalg.svd(flat, full_matrices=False)[2][0]
    row = {"settle_s": float((far[-1] + 1) / fps) if len(far) else 0.0, "period_s": np.nan, "over": np.nan}
    passes = np.flatnonzero(np.diff(np.sign(along)) != 0)
    lobes = [np.abs(lobe).max() for lobe in np.split(along, passes + 1)]
    if len(passes) and max(lobes) > SETTLED_M:
        first = int(np.argmax(lobes[:-1]))
        row["over"] = float(lobes[first + 1] / lobes[first])
        if first + 1 < len(passes):
            row["period_s"] = 2.0 * float(passes[first + 1] - passes[first]) / fps
    return row
