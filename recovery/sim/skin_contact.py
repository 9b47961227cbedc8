"""Contact with a body given by its signed distance: repulsion, friction, and the correction of equation 4."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from drape.errors import InputError
from recovery.sim.cloth_model import ClothState
from recovery.sim.sdf import SignedDistance


@dataclass(frozen=True)
class SkinContact:
    """Contact of cloth with ``body``: repulsion, friction and a correction.

    Repulsion has the energy of ``drape.cloth.energies.contact``: ``stiffness_j_m4`` times node area times the squared
    depth below ``gap_m``. Friction is Coulomb's with coefficient ``friction``, smoothed: it grows as
    speed / sqrt(speed^2 + ``slip_speed_m_s``^2), so that a sticking node creeps below that speed. A node that a
    linearised step leaves inside the body is put ``thickness_m`` outside (equation 4).
    """

    body: SignedDistance
    stiffness_j_m4: float = 3.0e5
    gap_m: float = 0.004
    friction: float = 0.3
    slip_speed_m_s: float = 1e-3
    thickness_m: float = 0.001

    def __post_init__(self) -> None:
        numbers = {name: value for name, value in vars(self).items() if name != "body"}
        for name, value in numbers.items():
            if not 0.0 <= value < float("inf") or (name == "slip_speed_m_s" and value == 0.0):
                raise InputError(
                    f"contact {name}", expected="a number >= 0 (slip speed > 0)", got=str(value), cure="Use SI units."
                )

    def energy(self, x: Tensor, node_area: Tensor) -> Tensor:
        """Repulsion energy [J] ()."""
        depth = torch.clamp(self.gap_m - self.body(x)[0], min=0.0)
        return self.stiffness_j_m4 * (node_area * depth * depth).sum()

    def force(self, x: Tensor, node_area: Tensor) -> Tensor:
        """Repulsion [N] (V, 3)."""
        distance, gradient = self.body(x)
        return self._magnitude(distance, node_area)[:, None] * gradient

    def stiffness(self, x: Tensor, node_area: Tensor) -> tuple[Tensor, Tensor]:
        """c [N/m] (V,) and r (V, 3): the repulsion's stiffness is c r r^T, the body's curvature left out."""
        distance, gradient = self.body(x)
        return torch.where(distance < self.gap_m, 2.0 * self.stiffness_j_m4 * node_area, 0.0), gradient

    def grip(self, x: Tensor, node_area: Tensor) -> tuple[Tensor, Tensor]:
        """Greatest friction [N] (V,) and the unit normals (V, 3) at ``x``."""
        distance, gradient = self.body(x)
        return self.friction * self._magnitude(distance, node_area), _unit(gradient)

    def drag(self, x: Tensor, v: Tensor, node_area: Tensor) -> tuple[Tensor, Tensor]:
        """Friction per tangential speed [N s/m] (V,) at velocity ``v``, and the unit normals (V, 3)."""
        limit, normal = self.grip(x, node_area)
        slip = tangential(v, normal)
        return limit / torch.sqrt((slip * slip).sum(dim=1) + self.slip_speed_m_s**2), normal

    def friction_potential(self, move: Tensor, limit: Tensor, normal: Tensor, *, dt_s: float) -> Tensor:
        """Incremental potential [J] () of sliding by ``move`` [m] (V, 3) against ``limit`` [N]."""
        slip = tangential(move, normal)
        smooth = self.slip_speed_m_s * dt_s
        return (limit * (torch.sqrt((slip * slip).sum(dim=1) + smooth**2) - smooth)).sum()

    def friction_resistance(self, move: Tensor, limit: Tensor, normal: Tensor, *, dt_s: float) -> Tensor:
        """Derivative [N] (V, 3) of ``friction_potential`` by ``move``: minus the friction."""
        return self.friction_stiffness(move, limit, normal, dt_s=dt_s)[:, None] * tangential(move, normal)

    def friction_stiffness(self, move: Tensor, limit: Tensor, normal: Tensor, *, dt_s: float) -> Tensor:
        """Secant stiffness [N/m] (V,) across the normal, at least the tangent one."""
        slip = tangential(move, normal)
        return limit / torch.sqrt((slip * slip).sum(dim=1) + (self.slip_speed_m_s * dt_s) ** 2)

    def corrected(self, state: ClothState, free: Tensor) -> ClothState:
        """Equation 4: nodes inside the body put ``thickness_m`` outside it, without their inward velocity."""
        distance, gradient = self.body(state.x)
        normal = _unit(gradient)
        inside = ((distance < 0.0)[:, None] & (free > 0.0)).to(state.x.dtype)
        inward = torch.clamp((state.v * normal).sum(dim=1, keepdim=True), max=0.0)
        x = state.x + inside * (self.thickness_m - distance)[:, None] * normal
        return ClothState(x, state.v - inside * inward * normal)

    def _magnitude(self, distance: Tensor, node_area: Tensor) -> Tensor:
        return 2.0 * self.stiffness_j_m4 * node_area * torch.clamp(self.gap_m - distance, min=0.0)


def tangential(vectors: Tensor, normal: Tensor) -> Tensor:
    """The part (V, 3) of ``vectors`` across the unit ``normal``."""
    return vectors - (vectors * normal).sum(dim=1, keepdim=True) * normal


def _unit(gradient: Tensor) -> Tensor:
    return gradient / torch.sqrt((gradient * gradient).sum(dim=1, keepdim=True) + 1e-30)
