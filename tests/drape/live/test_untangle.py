"""Untangling: pairs that cross are found as the readable way finds them, and shallow crossings come apart."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.engine.calls import call_with_scratch
from drape.engine.library import LANES
from drape.engine.packer import Record
from drape.geometry.triangle_pairs import crossing_pairs
from drape.live.untangle import BORDER, OTHERS, Tangles, tangles_of
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.live.folds_setup import spared
from tests.fixtures.laws import each

STEPS, WAY_M, MOST_PAIRS = 4, 0.002, 8192


def sheets(depth_m: float) -> tuple[np.ndarray, np.ndarray]:
    """A sheet, and another one across it whose border passes through it by ``depth_m``."""
    flat, faces = grid(12, 12)
    other = flat[:, [0, 2, 1]] + np.array([0.0043, 0.0437, 0.0])
    other[:, 2] -= other[:, 2].min() + depth_m
    other[:, 1] += 0.3 * other[:, 2]  # neither parallel to an edge nor at right angles
    return np.concatenate([flat, other]), np.concatenate([faces, faces + len(flat)])


def poked(depth_m: float) -> tuple[np.ndarray, np.ndarray]:
    """A sheet, and another one 2 mm behind it with a bump that passes through it by ``depth_m``."""
    flat, faces = grid(12, 12)
    off = flat + np.array([0.0043, 0.0037, -0.002])
    off[:, 2] += (depth_m + 0.002) * np.exp(-((off[:, :2] - 0.061) ** 2).sum(axis=1) / 0.02**2)
    return np.concatenate([flat, off]), np.concatenate([faces, faces + len(flat)])


def every(tangles: Tangles) -> np.ndarray:
    return np.arange(len(tangles.start) - 1, dtype=np.int32)


def apart(x: np.ndarray, tangles: Tangles, chosen: np.ndarray | None = None) -> np.ndarray:
    """Moves ``x`` (V, 3) in place, and tells how many ways each vertex had in the last step (V,)."""
    chosen, moved = every(tangles) if chosen is None else chosen, spared(x)
    given = (len(x), Record("Tangles", tangles), chosen, len(chosen), WAY_M, count := np.empty(len(x), x.dtype))
    call_with_scratch("law_untangle", x.dtype, moved, *given)
    x[:] = moved
    return count


def crossing(x: np.ndarray, tangles: Tangles) -> np.ndarray:
    """Pairs (N, 2) of triangles that may cross, cluster times ``LANES`` plus lane."""
    chosen, pairs = every(tangles), np.empty((MOST_PAIRS, 2), np.int32)
    given = (spared(x), Record("Tangles", tangles), chosen, len(chosen), pairs)
    return pairs[: call_with_scratch("law_crossing", x.dtype, *given)]


def triangles_of(pairs: np.ndarray, tangles: Tangles, faces: np.ndarray) -> set[tuple[int, ...]]:
    """``pairs`` of lanes as pairs of ``faces``."""
    corner = tangles.corner.reshape(-1, 3, LANES).transpose(0, 2, 1).reshape(-1, 3)
    number = {tuple(face): f for f, face in enumerate(faces)}
    return {tuple(sorted(number[tuple(corner[t])] for t in pair)) for pair in pairs}


@each(dtype=(np.float32, np.float64))
def test_no_pair_that_crosses_is_missed(rng, dtype):
    vertices, faces = sheets(0.02)
    x = (vertices + rng.normal(scale=0.002, size=vertices.shape)).astype(dtype)
    tangles = tangles_of(faces, np.arange(len(x)))
    crosses = crossing_pairs(x.astype(np.float64), faces)
    assert len(crosses) > 10
    assert set(map(tuple, crosses)) <= triangles_of(crossing(x, tangles), tangles, faces)


def test_cloth_that_folds_onto_itself_is_searched():
    vertices, faces = grid(24, 6)
    turned = vertices.copy()
    right = vertices[:, 0] > 0.11
    turned[right, 0] = 0.22 - vertices[right, 0]
    turned[right, 1] += 0.0031  # off the lines of the other half
    turned[:, 2] += np.where(right, 0.5 * (turned[:, 0] - 0.0537), 0.0)
    crosses = crossing_pairs(turned, faces)
    tangles = tangles_of(faces, np.arange(len(turned)))
    assert len(crosses) > 0
    assert set(map(tuple, crosses)) <= triangles_of(crossing(turned, tangles), tangles, faces)


def test_smooth_cloth_stays_bit_for_bit():
    vertices, faces = grid(12, 12)
    x = vertices + 0.01 * np.sin(40.0 * vertices[:, [1, 2, 0]])
    before = x.copy()
    assert not apart(x, tangles_of(faces, np.arange(len(x)))).any()
    assert_array_equal(x, before)


@each(dtype=(np.float32, np.float64))
def test_a_bump_that_passes_through_comes_out(dtype):
    vertices, faces = poked(0.002)
    x, tangles = vertices.astype(dtype), tangles_of(faces, np.arange(len(vertices)))
    assert len(crossing_pairs(x.astype(np.float64), faces)) > 0
    for _ in range(8):
        before = x.copy()
        apart(x, tangles)
        assert np.abs(x - before).max() <= 1.01 * STEPS * WAY_M
    assert len(crossing_pairs(x.astype(np.float64), faces)) == 0


def test_both_sheets_share_the_way():
    """One sheet is pushed one way, the other one the other way."""
    vertices, faces = poked(0.002)
    x = vertices.copy()
    apart(x, tangles_of(faces, np.arange(len(x))))
    half = len(x) // 2
    first, second = (x - vertices)[:half].sum(axis=0), (x - vertices)[half:].sum(axis=0)
    assert float(first @ second) < 0.0


def test_every_edge_counts_for_one_of_its_triangles():
    _, faces = grid(5, 4)
    tangles = tangles_of(faces, np.arange(faces.max() + 1))
    corner, across = (each.reshape(-1, 3, LANES).transpose(0, 2, 1).reshape(-1, 3) for each in tangles[:2])
    seen = {}
    for own, other in zip(corner, across, strict=True):
        for n in range(3):
            if other[n] != OTHERS:
                seen[tuple(sorted((own[n], own[(n + 1) % 3])))] = int(other[n])
    edges = {tuple(sorted((f[n], f[(n + 1) % 3]))): [] for f in faces for n in range(3)}
    for f in faces:
        for n in range(3):
            edges[tuple(sorted((f[n], f[(n + 1) % 3])))].append(f[(n + 2) % 3])
    assert seen.keys() == edges.keys()
    for edge, there in edges.items():
        assert (seen[edge] == BORDER) if len(there) == 1 else (seen[edge] in there)


def test_a_triangle_without_an_area_moves_nothing():
    vertices, faces = sheets(0.004)
    vertices[faces[0]] = vertices[faces[0, 0]]
    x = vertices.copy()
    apart(x, tangles_of(faces, np.arange(len(x))))
    assert np.isfinite(x).all()
    assert pytest.approx(0.0, abs=(STEPS + 1) * WAY_M) == float(np.abs(x - vertices).max())


def test_clusters_that_are_not_chosen_stay_as_they_are():
    """Two pairs of sheets that cross: the clusters of one are chosen, and the other one's vertices do not move."""
    vertices, faces = sheets(0.003)
    x = np.concatenate([vertices, vertices + np.array([1.0, 0.0, 0.0])])
    both = np.concatenate([faces, faces + len(vertices)])
    tangles = tangles_of(both, np.arange(len(x)))
    corner = tangles.corner.reshape(-1, 3 * LANES)
    first = np.flatnonzero((corner < len(vertices)).all(axis=1)).astype(np.int32)
    assert 0 < len(first) < len(corner)
    before = x.copy()
    assert apart(x, tangles, first).any() and not apart(x, tangles, first[:0]).any()
    assert_array_equal(x[len(vertices) :], before[len(vertices) :])
    assert np.abs(x - before)[: len(vertices)].max() > 0.0
