"""Chart consensus, and the strain of the charts that agree: what the network's corrections read.

Two forms of the same tables: ``GatheredConsensus`` reads as the formula and is what export writes, ``SparseConsensus``
is what training runs.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.sparse
import torch
from torch import Tensor

from drape.garment.consensus import FIT_COUNT, TRACE_SHARE, strain_points
from drape.geometry import jets
from drape.graph.inputs import AgreementTensors


class ChartConsensus(Protocol):
    """Constant tables of a garment by which its charts are fitted to their blend and strained. Names and meaning are
    those of ``drape.garment.consensus.Consensus``: K patches, A anchors."""

    @property
    def rest(self) -> Tensor:
        """The polynomials (K, 21, 3) [patch scales] of the patches at rest, in their frames."""
        ...

    @property
    def tangent(self) -> Tensor:
        """The derivatives of the rest jets by u and v at the strain points (K, 7, 3, 2)."""
        ...

    @property
    def orthonormal(self) -> Tensor:
        """The upper triangular matrices (K, 7, 2, 2) that make orthonormal vectors of ``tangent``."""
        ...

    def anchors(self, coefficients: Tensor) -> Tensor:
        """Returns the anchors [m] (F, A, 3) where the blend of their charts puts them. ``coefficients`` (F, K, 19, 3)
        are those of ``onefit.posed_coefficients``, or their first four rows (F, K, 4, 3) for rigid patches."""
        ...

    def fitted(self, anchors: Tensor, centre: Tensor) -> Tensor:
        """Returns polynomials [m] (F, K, 21, 3), in world axes, fitted in each patch to its ``anchors`` [m] (F, A, 3),
        taken relative to the patch's ``centre`` [m] (F, K, 3)."""
        ...


@dataclass(frozen=True, eq=False)
class GatheredConsensus(AgreementTensors):
    """The tables as dense tensors and indices, as the drape graph takes them."""

    def anchors(self, coefficients: Tensor) -> Tensor:
        rows, count = coefficients.shape[2], self.anchor_patch.shape[0]
        gathered = torch.index_select(coefficients.flatten(2), 1, self.anchor_patch.reshape(-1))
        row = self.anchor_row[..., :rows].reshape(1, count, 1, -1)
        return (row @ gathered.reshape(coefficients.shape[0], count, -1, 3))[..., 0, :]

    def fitted(self, anchors: Tensor, centre: Tensor) -> Tensor:
        places = torch.index_select(anchors, 1, self.member.reshape(-1))
        places = places.reshape(anchors.shape[0], *self.member.shape, 3)
        return self.fit @ (places - centre[:, :, None])


@dataclass(frozen=True, eq=False)
class SparseConsensus:
    """Tables as sparse matrices, whose gradients do not scatter; equals ``GatheredConsensus``.

    ``blend`` (A, 19 K) gives anchors from posed coefficients, ``rigid`` (A, 4 K) from the first four of each patch.
    ``fit`` (21 K, A) gives polynomials from anchors; ``fit_total`` (K, 21, 1) are the sums of its rows, by which a
    patch's centre is taken off. ``rest``, ``tangent`` and ``orthonormal`` are those of ``ChartConsensus``.
    """

    rigid: SparsePair  # (A, 4 K)
    blend: SparsePair  # (A, 19 K)
    fit: SparsePair  # (21 K, A)
    fit_total: Tensor  # (K, 21, 1)
    rest: Tensor
    tangent: Tensor
    orthonormal: Tensor

    @classmethod
    def of(cls, feed: Mapping[str, np.ndarray], *, device: torch.device) -> SparseConsensus:
        """Returns the tables on ``device`` of the partition whose ``drape.graph.feeds.atlas_feed`` is ``feed``."""
        tables = AgreementTensors.from_flat(feed)
        count, anchors = len(tables.member), len(tables.anchor_patch)
        rows = blend_matrix(tables.anchor_patch, tables.anchor_row, count)
        framed = (np.arange(count)[:, None] * tables.anchor_row.shape[2] + np.arange(4)).ravel()
        row = np.broadcast_to(np.arange(count * FIT_COUNT).reshape(count, FIT_COUNT, 1), tables.fit.shape)
        column = np.broadcast_to(tables.member[:, None], tables.fit.shape)
        fit = scipy.sparse.csr_matrix(
            (tables.fit.ravel(), (row.ravel(), column.ravel())), shape=(count * FIT_COUNT, anchors)
        )
        fit.sum_duplicates()
        fit.eliminate_zeros()

        def tensor(values: np.ndarray) -> Tensor:
            return torch.from_numpy(values).to(device)

        return cls(
            rigid=SparsePair.from_scipy(scipy.sparse.csr_matrix(rows[:, framed]), device=device),
            blend=SparsePair.from_scipy(rows, device=device),
            fit=SparsePair.from_scipy(fit, device=device),
            fit_total=tensor(tables.fit.sum(axis=2, keepdims=True)),
            rest=tensor(tables.rest),
            tangent=tensor(tables.tangent),
            orthonormal=tensor(tables.orthonormal),
        )

    def anchors(self, coefficients: Tensor) -> Tensor:
        return framewise_product(self.rigid if coefficients.shape[2] == 4 else self.blend, coefficients.flatten(1, 2))

    def fitted(self, anchors: Tensor, centre: Tensor) -> Tensor:
        fitted = framewise_product(self.fit, anchors).unflatten(1, (centre.shape[1], FIT_COUNT))
        return fitted - self.fit_total * centre[:, :, None]


def blend_matrix(patch: np.ndarray, row: np.ndarray, count: int) -> scipy.sparse.csr_matrix:
    """Returns the sparse matrix (n, m ``count``) that gives n points from m coefficients of each of ``count`` patches.
    ``patch`` (n, 4) are the patches of each point's charts, ``row`` (n, 4, m) what multiplies their coefficients."""
    terms = row.shape[2]
    column = patch[..., None] * terms + np.arange(terms)
    point = np.broadcast_to(np.arange(len(patch))[:, None, None], column.shape)
    matrix = scipy.sparse.csr_matrix((row.ravel(), (point.ravel(), column.ravel())), shape=(len(patch), count * terms))
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    return matrix


def framewise_product(pair: SparsePair, values: Tensor) -> Tensor:
    """Returns the products (F, n, 3) of the sparse matrix ``pair`` (n, m) with ``values`` (F, m, 3), frame by frame."""
    frames = values.shape[0]
    flat = product(pair, values.permute(1, 2, 0).reshape(values.shape[1], 3 * frames))
    return flat.reshape(-1, 3, frames).permute(2, 0, 1)


def agreed_jets(anchors: Tensor, charts: ChartConsensus, rotation: Tensor, centre: Tensor, scale: Tensor) -> Tensor:
    """Returns the changes (F, K, 27) [patch scales] of the rest jets with which the charts fit ``anchors`` [m]
    (F, A, 3).

    ``rotation`` (F, K, 3, 3) and ``centre`` (F, K, 3) [m] are the posed frames, ``scale`` (K,) [m] the patches' sizes.
    """
    local = _moved(anchors, charts, rotation, centre, scale)
    plane, height = local[..., jets.HEIGHT_COUNT :, :], local[..., : jets.HEIGHT_COUNT, 2]
    return torch.cat([plane[..., 0], plane[..., 1], height], dim=-1)


def closing_jets(anchors: Tensor, charts: ChartConsensus, rotation: Tensor, centre: Tensor, scale: Tensor) -> Tensor:
    """Returns the changes (F, K, 45) [patch scales] of the full rest jets with which the charts fit ``anchors``, as
    ``agreed_jets`` does, but with polynomials of the height's order along all three axes."""
    return _moved(anchors, charts, rotation, centre, scale)[..., : jets.HEIGHT_COUNT, :].mT.flatten(-2)


def _moved(anchors: Tensor, charts: ChartConsensus, rotation: Tensor, centre: Tensor, scale: Tensor) -> Tensor:
    """Polynomials (F, K, 21, 3) of ``anchors`` in the posed frames, less those at rest [patch scales]."""
    return charts.fitted(anchors, centre) @ (rotation / scale[:, None, None]) - charts.rest


def tangent_terms() -> Tensor:
    """Returns the matrix (27, 42) by which the coefficients of a jet give its derivatives at the strain points: columns
    are sorted by point (7), axis (3) and parameter (2)."""
    points = strain_points()
    terms = np.zeros((jets.JET_COUNT, len(points), 3, 2))
    plane, height = jets.IN_PLANE_COUNT, jets.HEIGHT_COUNT
    for way, derivative in enumerate(({"u_times": 1}, {"v_times": 1})):
        by_plane = jets.basis_derivative(points, jets.IN_PLANE_ORDER, **derivative).T
        terms[:plane, :, 0, way] = by_plane
        terms[plane : 2 * plane, :, 1, way] = by_plane
        terms[2 * plane :, :, 2, way] = jets.basis_derivative(points, jets.HEIGHT_ORDER, **derivative).T
    assert terms.shape[0] == 2 * plane + height
    return torch.from_numpy(terms.reshape(jets.JET_COUNT, -1)).float()


def strain_and_force(jet: Tensor, charts: ChartConsensus, terms: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the Green strain E (F, K, 21) of posed charts at seven points each, and the gradient (F, K, 27) of
    |E|^2 / 2 + 0.15 tr(E)^2, summed over the points, by the coefficients of ``jet`` (F, K, 27) [patch scales].

    The strain is E11 at all points, then E22, then 2 E12, against the rest jet. ``terms`` are ``tangent_terms``.
    """
    frames, patches = jet.shape[:2]
    points = charts.tangent.shape[1]
    # Patches of all frames last: sums over coordinates then add long rows, and the 2 x 2 products are a few of them.
    rest = charts.tangent.permute(2, 3, 1, 0).unsqueeze(3)  # (3, 2, 7, 1, K)
    unit = charts.orthonormal.permute(2, 3, 1, 0).unsqueeze(3)
    moved = terms.T @ jet.reshape(-1, jet.shape[-1]).T
    tangent = moved.reshape(points, 3, 2, frames, patches).permute(1, 2, 0, 3, 4) + rest
    along, across = tangent[:, 0], tangent[:, 1]
    u = along * unit[0, 0] + across * unit[1, 0]
    v = along * unit[0, 1] + across * unit[1, 1]
    e11, e22 = 0.5 * ((u * u).sum(0) - 1.0), 0.5 * ((v * v).sum(0) - 1.0)
    e12 = 0.5 * (u * v).sum(0)
    trace = TRACE_SHARE * (e11 + e22)
    along_u = (e11 + trace) * u + e12 * v
    along_v = (e22 + trace) * v + e12 * u
    pull = torch.stack([along_u * unit[k, 0] + along_v * unit[k, 1] for k in range(2)], dim=1)  # (3, 2, 7, F, K)
    force = terms @ pull.permute(2, 0, 1, 3, 4).reshape(terms.shape[1], -1)
    strain = torch.cat([e11, e22, 2.0 * e12])
    return strain.permute(1, 2, 0), force.reshape(-1, frames, patches).permute(1, 2, 0)


def softened(x: Tensor) -> Tensor:
    """Returns ``4 x / (1 + 4 |x|)``, between -1 and 1: strains of a few percent fill the range, and torn patches stay
    within it."""
    return 4.0 * x / (1.0 + 4.0 * x.abs())


@dataclass(frozen=True)
class SparsePair:
    """A constant sparse matrix and its transpose, both CSR, so that neither direction scatters."""

    forward: Tensor
    transposed: Tensor

    @classmethod
    def from_scipy(cls, matrix: scipy.sparse.csr_matrix, *, device: torch.device) -> SparsePair:
        return cls(_csr(matrix, device), _csr(scipy.sparse.csr_matrix(matrix.T), device))


def _csr(matrix: scipy.sparse.csr_matrix, device: torch.device) -> Tensor:
    matrix.sort_indices()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        return torch.sparse_csr_tensor(
            torch.from_numpy(matrix.indptr.astype(np.int32)),
            torch.from_numpy(matrix.indices.astype(np.int32)),
            torch.from_numpy(matrix.data.astype(np.float32)),
            size=matrix.shape,
            device=device,
            check_invariants=False,
        )


class _Product(torch.autograd.Function):
    @staticmethod
    def forward(ctx, dense: Tensor, forward: Tensor, transposed: Tensor) -> Tensor:  # type: ignore[override]
        ctx.transposed = transposed
        return forward @ dense

    @staticmethod
    def backward(ctx, gradient: Tensor):  # type: ignore[override]
        return ctx.transposed @ gradient.contiguous(), None, None


def product(pair: SparsePair, dense: Tensor) -> Tensor:
    """Returns the product (V, n) of the sparse matrix ``pair`` (V, m) with ``dense`` (m, n), differentiable in
    ``dense``."""
    return _Product.apply(dense, pair.forward, pair.transposed)
