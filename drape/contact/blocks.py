"""Points in blocks of one size, each compact and facing one way, which are tested together."""

from __future__ import annotations

import numpy as np

FACING_M = 0.03  # normals count as so many metres: points that face opposite ways lie twice that far apart


def blocks(points: np.ndarray, normals: np.ndarray, size: int) -> np.ndarray:
    """Returns blocks of points that lie together, as indices (B, ``size``) int64 into ``points`` [m] (N, 3). Every
    point is in one block; a block with fewer points repeats its first one.

    The set is halved along its longest direction until a part fits, always at a multiple of ``size``. Unit ``normals``
    (N, 3) keep apart the two sides of thin parts, and the layers of a garment.
    """
    key = np.concatenate([points, FACING_M * normals], axis=1)
    groups: list[np.ndarray] = []
    waiting = [np.arange(len(points))]
    while waiting:
        members = waiting.pop()
        if len(members) <= size:
            if len(members):
                groups.append(np.concatenate([members, np.full(size - len(members), members[0])]))
            continue
        axis = int(np.ptp(key[members], axis=0).argmax())
        ordered = members[np.argsort(key[members, axis], kind="stable")]
        cut = size * max(1, round(len(members) / (2 * size)))
        waiting += [ordered[cut:], ordered[:cut]]
    return np.array(groups, dtype=np.int64).reshape(-1, size)
