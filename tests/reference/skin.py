"""Which samples of the skin cloth is at, and the planes below it, in NumPy: ``drape/engine/source/skin.hpp``."""

from __future__ import annotations

import numpy as np

from drape.live.fold_constants import WornCloth
from drape.live.skin_walks import SkinGraph, TouchedSamples

STEPS, TURNS, NEARER, REACH_M = 3, 4, 0.8, 0.045  # of walks and of searches for other parts
ALONG_STEPS, ALONG = 16, 0.5  # of walks on over skin that faces alike
BESIDE, FREE, HOLLOW_M, APART_M = 1.5, 2.5, 0.05, 0.12
BEYOND_M, THROUGH_M, BEFORE_M = 0.02, 0.015, 0.005  # below planes: in a part of the body, or through it


def follow(network: np.ndarray, skin: np.ndarray, graph: SkinGraph, touched: TouchedSamples) -> TouchedSamples:
    """``touched`` with the samples that the ``network``'s vertices [m] (V, 3) are at now."""
    walks = [_walked(point, skin, graph, own, len(skin)) for point, own in zip(network, touched.own, strict=True)]
    return TouchedSamples(np.array(walks), touched.other)


def laid_back(x: np.ndarray, network: np.ndarray, skin: np.ndarray, own: np.ndarray) -> np.ndarray:
    """``x`` [m] (V, 3), at the ``network``'s places where it lies behind the samples ``own`` (V,) and these do not."""
    way, normal = x - skin[own, :3], skin[own, 4:7]
    height, wanted = (way * normal).sum(axis=1), ((network - skin[own, :3]) * normal).sum(axis=1)
    through = (height < -THROUGH_M) & ((way**2).sum(axis=1) < 2.0 * height**2) & (wanted > -BEFORE_M)
    return np.where(through[:, None], network, x)


def touch(
    x: np.ndarray, network: np.ndarray, skin: np.ndarray, graph: SkinGraph, touched: TouchedSamples, turn: int
) -> tuple[TouchedSamples, TouchedSamples]:
    """The samples that ``x`` [m] (V, 3) is at, and ``touched`` moved on.

    Walks lead from the network's samples, on over skin that faces as these do, and searches find other parts: of one
    that the ``network``'s place is in only the side that faces the own sample.
    Where a search finds a nearer sample of the same part the next walk starts there.
    """
    own, other, begins = touched.own.copy(), touched.other.copy(), touched.own.copy()
    for v, point in enumerate(x):
        facing = skin[:, 4:7] @ skin[own[v], 4:7] > ALONG
        own[v] = _walked(point, skin, graph, own[v], STEPS)
        own[v] = _walked(point, skin, graph, own[v], ALONG_STEPS, facing)
        apart = np.linalg.norm(graph.rest - graph.rest[own[v]], axis=1)
        hollow = (apart > HOLLOW_M) & ((skin[:, :3] - skin[own[v], :3]) @ skin[own[v], 4:7] > 0.0)
        distance = np.linalg.norm(skin[:, :3] - point, axis=1)
        two = np.stack([network[v], skin[own[v], :3]])[:, None]
        beyond = (((two - skin[:, :3]) * skin[:, 4:7]).sum(axis=2) < -BEYOND_M).all(axis=0)
        allowed = (distance < REACH_M) & (hollow | (apart > APART_M)) & ~beyond
        if turn < 0 or v % TURNS == turn:
            other[v] = np.where(allowed, distance, np.inf).argmin() if allowed.any() else -1
            same = ~(hollow | (apart > APART_M)) & (distance < REACH_M) & (distance**2 < NEARER * distance[own[v]] ** 2)
            begins[v] = np.where(same, distance, np.inf).argmin() if same.any() else begins[v]
        elif other[v] >= 0:
            end = _walked(point, skin, graph, other[v], STEPS)
            other[v] = end if allowed[end] else -1
    return TouchedSamples(own, other), TouchedSamples(begins, other)


def _walked(
    point: np.ndarray, skin: np.ndarray, graph: SkinGraph, start: int, steps: int, allowed: np.ndarray | None = None
) -> int:
    """Where a walk from ``start`` ends, each of its ``steps`` to the nearest of sample and ``allowed`` neighbours."""
    for _ in range(steps):
        near = graph.neighbour[start]
        around = np.append(start, near if allowed is None else near[allowed[near]])
        best = int(around[np.linalg.norm(skin[around, :3] - point, axis=1).argmin()])
        if best == start:
            break
        start = best
    return start


def planes(x: np.ndarray, skin: np.ndarray, dressed: WornCloth, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] and unit normals (V, 3) of the planes at the samples ``index`` (V,), blended with the neighbours'."""
    points, normals = np.empty_like(x), np.empty_like(x)
    for v, (point, own) in enumerate(zip(x, index, strict=True)):
        around = np.append(own, np.setdiff1d(dressed.graph.neighbour[own], own))
        square = ((skin[around, :3] - point) ** 2).sum(axis=1)
        weight = np.clip(1.0 - (square - square[0]) / dressed.graph.reach_m2[own], 0.0, 1.0) ** 2
        weight /= weight.sum()
        blended = weight @ skin[around, 4:7]
        normal = blended / np.linalg.norm(blended)
        chord = point - skin[around, :3]
        distance = 0.5 * weight @ ((skin[around, 4:7] + normal) * chord).sum(axis=1)
        aside = (square[0] - (chord[0] @ skin[own, 4:7]) ** 2) / dressed.graph.reach_m2[own]
        beside = np.clip((aside - BESIDE) / (FREE - BESIDE), 0.0, 1.0)
        distance = (1.0 - beside) * distance + beside * REACH_M
        points[v], normals[v] = point - distance * normal, normal
    return points, normals
