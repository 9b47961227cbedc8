"""Membrane and bending of a whole sewn mesh: energy, forces, Hessian, and their contractions for the adjoint."""

from __future__ import annotations

import numpy as np
import scipy.sparse
import torch
from torch import Tensor

from drape.cloth import orthotropic
from recovery.sim.model import ClothModel, Parameters, Rest


def energy(model: ClothModel, rest: Rest, parameters: Parameters, x: Tensor) -> Tensor:
    """Elastic energy [J] () at nodes ``x`` (V, 3)."""
    membrane = orthotropic.membrane_energy(model.triangles(x), rest.shape, parameters.stretch)
    bending = orthotropic.bending_energy(model.hinges(x), rest.hinge_weight, parameters.bending_j, model.rest_angle)
    return membrane.sum() + bending.sum()


def forces(model: ClothModel, rest: Rest, parameters: Parameters, x: Tensor) -> Tensor:
    """Elastic forces [N] (V, 3): minus the derivative of ``energy``, assembled by the static map; no gradient."""
    membrane = orthotropic.membrane_gradient(model.triangles(x), rest.shape, parameters.stretch)
    bending = orthotropic.bending_gradient(model.hinges(x), rest.hinge_weight, parameters.bending_j, model.rest_angle)
    return -torch.from_numpy(model.assembly.gradient([membrane.detach().numpy(), bending.detach().numpy()]))


def hessian(
    model: ClothModel,
    rest: Rest,
    parameters: Parameters,
    x: Tensor,
    *,
    definite: bool,
    scale: float = 1.0,
    blocks: np.ndarray | None = None,
) -> scipy.sparse.csc_matrix:
    """``scale`` times the second derivative [N/m] (3V, 3V) of ``energy``, plus ``blocks`` (V, 3, 3) of the nodes.

    Rows and columns of fixed nodes are those of the identity. ``definite`` makes every element positive
    semidefinite: the geometric stiffness keeps the tensile stress only, hinges the square of their turn.
    """
    membrane = orthotropic.membrane_hessian(model.triangles(x), rest.shape, parameters.stretch, definite=definite)
    bending = orthotropic.bending_hessian(
        model.hinges(x), rest.hinge_weight, parameters.bending_j, model.rest_angle, definite=definite
    )
    blocks = np.zeros((model.node_count, 3, 3)) if blocks is None else blocks
    return model.assembly.matrix([membrane.detach().numpy(), bending.detach().numpy()], blocks=blocks, scale=scale)


def work(model: ClothModel, rest: Rest, parameters: Parameters, x: Tensor, direction: Tensor) -> Tensor:
    """Derivative of ``energy`` along ``direction`` (V, 3); differentiable once more."""
    membrane = orthotropic.membrane_work(model.triangles(x), rest.shape, parameters.stretch, model.triangles(direction))
    bending = orthotropic.bending_work(
        model.hinges(x), rest.hinge_weight, parameters.bending_j, model.hinges(direction), model.rest_angle
    )
    return membrane.sum() + bending.sum()


def bilinear(
    model: ClothModel, rest: Rest, parameters: Parameters, x: Tensor, left: Tensor, right: Tensor, *, definite: bool
) -> Tensor:
    """``left``^T ``hessian`` ``right`` without the matrix; differentiable once more."""
    membrane = orthotropic.membrane_bilinear(
        model.triangles(x),
        rest.shape,
        parameters.stretch,
        model.triangles(left),
        model.triangles(right),
        definite=definite,
    )
    bending = orthotropic.bending_bilinear(
        model.hinges(x),
        rest.hinge_weight,
        parameters.bending_j,
        model.hinges(left),
        model.hinges(right),
        model.rest_angle,
        definite=definite,
    )
    return membrane.sum() + bending.sum()
