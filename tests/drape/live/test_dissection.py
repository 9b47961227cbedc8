"""Orders of a factor: each vertex once, fewer entries than in the mesh's order, runs that cover all columns."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from numpy.testing import assert_array_equal

from drape.live.dissection import COSTS, WIDEST, Costs, dissection_order, runs
from tests.drape.cloth.cloth_shapes import grid


def mesh_matrix(*parts: np.ndarray) -> Any:
    """A positive matrix with an entry for each edge of the faces of ``parts`` (F, 3), which share no vertex."""
    shift = np.cumsum([0, *(part.max() + 1 for part in parts)])
    faces = np.concatenate([part + first for part, first in zip(parts, shift[:-1], strict=True)])
    rows, columns = (np.broadcast_to(i, (3, 3, len(faces))).reshape(-1) for i in (faces.T[:, None], faces.T[None]))
    ones = scipy.sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(shift[-1], shift[-1])).tocsr()
    ones.data[:] = -1.0
    return (ones + 20.0 * scipy.sparse.identity(shift[-1])).tocsr()


def lower(matrix: Any, order: np.ndarray) -> Any:
    """The factor of ``matrix`` in ``order`` below its diagonal."""
    factor = scipy.sparse.linalg.splu(
        matrix[order][:, order].tocsc(), "NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    found = scipy.sparse.tril(factor.L, -1).tocsc()
    found.sort_indices()
    return found


def test_an_order_has_each_vertex_once_and_saves_entries(rng):
    _, faces = grid(20, 15)
    count = faces.max() + 1
    shuffled = rng.permutation(count)[faces]
    for parts in ((shuffled,), (shuffled, faces), (faces[:1],)):
        matrix = mesh_matrix(*parts)
        order = dissection_order(matrix.indptr, matrix.indices)
        assert_array_equal(np.sort(order), np.arange(matrix.shape[0]))
    matrix = mesh_matrix(shuffled)
    found = lower(matrix, dissection_order(matrix.indptr, matrix.indices))
    assert found.nnz < 0.75 * lower(matrix, np.arange(count)).nnz


def test_runs_cover_all_columns_and_are_long_where_rows_are_alike():
    full: Any = scipy.sparse.csc_matrix(np.tril(np.ones((80, 80)), -1))
    begin = runs(full.indptr, full.indices, COSTS)
    assert begin[0] == 0 and begin[-1] == 80
    assert (np.diff(begin) > 0).all() and np.diff(begin).max() <= WIDEST and len(begin) <= 8
    # Where entries are all that costs, columns that have no row in common are taken one by one.
    apart = np.zeros((404, 404))
    for j in range(4):
        apart[4 + 100 * j : 104 + 100 * j, j] = 1.0
    sparse: Any = scipy.sparse.csc_matrix(apart)
    assert_array_equal(runs(sparse.indptr, sparse.indices, Costs(1.0, 0.0, 0.0, 0.0))[:5], np.arange(5))
