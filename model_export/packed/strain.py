"""Strain of the packed graph's patches and the force on their jets, in ten operations on rows of numbers.

With the tangents t_u, t_v at a point and their sum as a third direction, squared lengths q are all that strain depends
on, and it is linear in them: g_uv = (q_3 - q_1 - q_2) / 2. Unit vectors across come in as products of the upper
triangle (a, b; 0, c) of ``drape.garment.consensus``, "monomials" a a, a b, a c, b b, b c, c c of each point:

    E = F (m * G q) - 1/2,        -dW/dt = 2 t * G^T (m * F^T dW/dE)

with constant matrices G and F, so the force takes the same way back. It equals
``training.chart_consensus.strain_and_force``.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from drape.garment.consensus import STRAIN_POINTS, TRACE_SHARE
from drape.geometry import jets
from model_export.packed.operators import WithTables, softsign
from training.chart_consensus import tangent_terms

SOFTENING = 4.0  # training.chart_consensus.softened is 4 x / (1 + |4 x|)
DIRECTIONS = ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0))  # u and v along each of the three directions
# Factors of (a, b, c) in each monomial, and of (q_1, q_2, q_3) in the product of tangents that it multiplies.
MONOMIALS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_UU, _VV, _UV = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-0.5, -0.5, 0.5)
PRODUCTS = (_UU, _UU, _UV, _UU, _UV, _VV)
# Coefficients of E11, E22 and 2 E12 in the terms monomial x product.
STRAINS = ((0.5, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.5, 1.0, 0.5), (0.0, 1.0, 1.0, 0.0, 0.0, 0.0))
# dW/dE of W = |E|^2 / 2 + 0.15 tr(E)^2 by E11, E22 and 2 E12.
STRESS = ((1.0 + TRACE_SHARE, TRACE_SHARE, 0.0), (TRACE_SHARE, 1.0 + TRACE_SHARE, 0.0), (0.0, 0.0, 0.5))


@dataclass(frozen=True)
class Stretch:
    """What ``Strain`` needs of P patches at rest, at seven points each. ``tangent`` (P, 63) are the rest jets'
    derivatives in the module's three directions, by direction, axis and point. ``monomials`` (P, 42) are products of
    two of a point's three numbers in ``strain_unit``, by ``MONOMIALS`` and point."""

    tangent: Tensor
    monomials: Tensor


def _strain_tables() -> dict[str, Tensor]:
    """Returns the constant matrices that ``Strain`` multiplies with, by the names of its buffers.

    The numbers of a point lie together by kind, points last.
    """
    directions = torch.tensor(DIRECTIONS)
    terms = tangent_terms().reshape(jets.JET_COUNT, STRAIN_POINTS, 3, 2)
    xyz = torch.ones(3)
    product, strain, stress = torch.tensor(PRODUCTS).T, torch.tensor(STRAINS).T, torch.tensor(STRESS)
    first, second = (
        torch.nn.functional.one_hot(torch.tensor(side), 3).T.float() for side in zip(*MONOMIALS, strict=True)
    )
    return {
        "direction_terms": torch.einsum("jpxk,dk->jdxp", terms, directions).reshape(jets.JET_COUNT, -1).contiguous(),
        "directions": _per_point(torch.einsum("dk,xy->kxdy", directions, torch.eye(3)).reshape(6, 9)),
        "first_factor": _per_point(first),
        "second_factor": _per_point(second),
        "tangent_products": _per_point(torch.einsum("dm,x->dxm", product, xyz).reshape(9, 6)),
        "strain_sums": _per_point(SOFTENING * strain),
        "strain_at_rest": torch.tensor([-0.5 * SOFTENING, -0.5 * SOFTENING, 0.0]).repeat_interleave(STRAIN_POINTS)[
            None
        ],
        "stress_terms": _per_point(stress @ strain.T),
        "force_terms": _per_point(2.0 * torch.einsum("dm,x->mdx", product, xyz).reshape(6, 9)),
    }


def _per_point(matrix: Tensor) -> Tensor:
    """``matrix`` (n, m) of one point as a matrix (7 n, 7 m) of all points, numbers sorted by kind."""
    return torch.kron(matrix.contiguous(), torch.eye(STRAIN_POINTS))


class Strain(WithTables):
    """A module without weights that computes the strain of patches and the force on their jets, both softened by
    ``training.chart_consensus.softened``."""

    def __init__(self) -> None:
        super().__init__(_strain_tables())

    def stretch(self, tangent: Tensor, unit: Tensor) -> Stretch:
        """Returns the constants of P patches from the graph's inputs ``strain_tangent`` (P, 42) and ``strain_unit``
        (P, 3, 7)."""
        factors = unit.reshape(-1, 3 * STRAIN_POINTS)
        return Stretch(tangent @ self.directions, (factors @ self.first_factor) * (factors @ self.second_factor))

    def forward(self, jet: Tensor, rest: Stretch) -> tuple[Tensor, Tensor]:
        """Returns the strain (P, 21) and the force (P, 27) on the jets, both softened to between -1 and 1, of patches
        whose rest jets change by ``jet`` (P, 27) [patch scales]."""
        tangent = torch.addmm(rest.tangent, jet, self.direction_terms)
        terms = rest.monomials * ((tangent * tangent) @ self.tangent_products)
        strain = torch.addmm(self.strain_at_rest, terms, self.strain_sums)  # times the softening, as all that follows
        along = (rest.monomials * (strain @ self.stress_terms)) @ self.force_terms
        return softsign(strain), softsign((along * tangent) @ self.direction_terms.mT)
