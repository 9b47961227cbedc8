"""Points in blocks of one size, each compact and facing one way: what is tested together."""

from __future__ import annotations

import numpy as np

FACING_M = 0.03  # how far apart two points lie that face opposite ways: half of it per unit of normal


def blocks(points: np.ndarray, normals: np.ndarray, size: int) -> np.ndarray:
    """Indices (B, ``size``) of ``points`` [m] (N, 3), every point in one block; the last fill up with their first.

    The set is halved along its longest direction until it fits, each cut at a multiple of ``size``. ``normals``
    (N, 3) keep the two sides of thin parts and the layers of a garment apart.
    """
    key = np.concatenate([points, FACING_M * normals], axis=1)
    found: list[np.ndarray] = []
    waiting = [np.arange(len(points))]
    while waiting:
        members = waiting.pop()
        if len(members) <= size:
            if len(members):
                found.append(np.concatenate([members, np.full(size - len(members), members[0])]))
            continue
        axis = int(np.ptp(key[members], axis=0).argmax())
        ordered = members[np.argsort(key[members, axis], kind="stable")]
        cut = size * max(1, round(len(members) / (2 * size)))
        waiting += [ordered[cut:], ordered[:cut]]
    return np.array(found, dtype=np.int64).reshape(-1, size)
