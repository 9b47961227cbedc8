"""The nodes of a swing mesh in blocks of ``LANES``, as the engine sweeps them.

A sweep takes node after node in an order that counts: it begins where cloth is held. Nodes that are not of one triangle
may move at once wherever the order has them. So a block takes nodes all of whose neighbours in front of them are in
blocks before, those first that most is waiting for. A sweep over blocks, there or back, then gives what one over nodes
does, for a tenth of the steps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.engine.library import LANES


class SwingRows(NamedTuple):
    """N nodes at P places in blocks of ``LANES``: first ``moving`` blocks of nodes that may move, then those of the
    others.

    ``node`` (P,) is the node at each place. A block that is not full repeats its first node, as if that were another
    one; ``place`` (N,) is the first place of each node. Block b has the rows ``start[b]`` to ``start[b + 1]`` of
    triangles: two rows of ``other``, the places of the other corners, and five of ``slope``, as ``SwingMesh`` has them.
    Rows of nodes with fewer triangles are filled with the node's own place and slopes of zero.
    """

    moving: int
    node: np.ndarray
    place: np.ndarray
    start: np.ndarray
    other: np.ndarray
    slope: np.ndarray


def swing_rows(order: np.ndarray, start: np.ndarray, other: np.ndarray, slope: np.ndarray) -> SwingRows:
    """Returns the nodes of a swing mesh in blocks. ``order`` (n,) are the nodes that move, in the order of a sweep;
    ``start`` (N + 1,), ``other`` and ``slope`` are the triangles of each node, as in ``SwingMesh``."""
    count = len(start) - 1
    blocks = _blocks(order, start, other)
    still = np.setdiff1d(np.arange(count), order)
    full = [*blocks, *(still[i : i + LANES] for i in range(0, len(still), LANES))]
    node = np.stack([np.pad(block, (0, LANES - len(block)), constant_values=block[0]) for block in full])
    place = np.empty(count, np.int32)
    for number, block in enumerate(full):
        place[block] = LANES * number + np.arange(len(block))
    fans = np.diff(start)[node]
    rows = fans.max(axis=1)
    first = np.concatenate([[0], np.cumsum(rows)])
    block = np.repeat(np.arange(len(full)), rows)
    number = (np.arange(first[-1]) - first[block])[:, None]
    real = number < fans[block]
    entry = np.where(real, start[node[block]] + number, 0)
    corners = np.where(real[..., None], place[other[entry]], (LANES * block[:, None] + np.arange(LANES))[..., None])
    return SwingRows(
        len(blocks),
        node.reshape(-1).astype(np.int32),
        place,
        first.astype(np.int32),
        np.ascontiguousarray(corners.transpose(0, 2, 1), np.int32).reshape(-1),
        np.ascontiguousarray(np.where(real[..., None], slope[entry], 0.0).transpose(0, 2, 1), slope.dtype).reshape(-1),
    )


def _blocks(order: np.ndarray, start: np.ndarray, other: np.ndarray) -> list[np.ndarray]:
    """The nodes of ``order`` in blocks of ``LANES`` at most, each after its neighbours that come before it there."""
    rank = dict.fromkeys(range(len(start) - 1), -1) | {int(i): n for n, i in enumerate(order)}
    beside = [np.unique(other[start[i] : start[i + 1]]) for i in order]
    before = [{rank[j] for j in near.tolist() if 0 <= rank[j] < n} for n, near in enumerate(beside)]
    waiting = np.zeros(len(order), int)  # the least number of blocks that have to come after this node's
    for n in reversed(range(len(order))):
        for m in before[n]:
            waiting[m] = max(waiting[m], waiting[n] + 1)
    left, blocks = set(range(len(order))), []
    while left:
        ready = sorted((n for n in left if not before[n] & left), key=lambda n: (-waiting[n], n))[:LANES]
        left -= set(ready)
        blocks.append(order[ready])
    return blocks
