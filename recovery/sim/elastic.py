"""Membrane and bending of a whole sewn mesh: energy, forces, Hessian, and their contractions for the adjoint.

The formulas are those of ``drape.cloth.membrane`` and ``drape.cloth.bending``.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
import torch
from torch import Tensor

from drape.cloth import bending, membrane
from recovery.sim.cloth_model import ClothModel, Parameters, Rest


def elastic_energy(model: ClothModel, rest: Rest, parameters: Parameters, x: Tensor) -> Tensor:
    """Elastic energy [J] () at nodes ``x`` (V, 3)."""
    stretched = membrane.membrane_energy(model.triangles(x), rest.triangles, parameters.membrane)
    return stretched.sum() + bending.bending_energy(model.hinges(x), *_hinges(model, rest, parameters)).sum()


def forces(model: ClothModel, rest: Rest, parameters: Parameters, x: Tensor) -> Tensor:
    """Elastic forces [N] (V, 3): minus the derivative of ``elastic_energy``, assembled by the static map.

    It has no gradient.
    """
    return -torch.from_numpy(model.assembly.gradient(_numpy(_gradients(model, rest, parameters, x))))


def elastic_hessian(
    model: ClothModel,
    rest: Rest,
    parameters: Parameters,
    x: Tensor,
    *,
    definite: bool,
    scale: float = 1.0,
    blocks: np.ndarray | None = None,
) -> scipy.sparse.csc_matrix:
    """Returns ``scale`` times the second derivative [N/m] (3V, 3V) of ``elastic_energy``, plus ``blocks`` (V, 3, 3)
    of the nodes.

    Rows and columns of fixed nodes are those of the identity. ``definite`` makes every element positive semidefinite:
    triangles keep the tensile stress only, hinges are as stiff as unbent ones.
    """
    stretched = membrane.membrane_hessian(model.triangles(x), rest.triangles, parameters.membrane, definite=definite)
    bent = bending.bending_hessian(model.hinges(x), *_hinges(model, rest, parameters), definite=definite)
    blocks = np.zeros((model.node_count, 3, 3)) if blocks is None else blocks
    return model.assembly.matrix(_numpy([stretched, bent]), blocks=blocks, scale=scale)


def work(model: ClothModel, rest: Rest, parameters: Parameters, x: Tensor, direction: Tensor) -> Tensor:
    """The derivative () of ``elastic_energy`` along ``direction`` (V, 3), in [J] for a direction in [m]; differentiable
    once more.
    """
    directions = model.triangles(direction), model.hinges(direction)
    gradients = _gradients(model, rest, parameters, x)
    return torch.stack([(slope * way).sum() for slope, way in zip(gradients, directions, strict=True)]).sum()


def elastic_bilinear(
    model: ClothModel, rest: Rest, parameters: Parameters, x: Tensor, left: Tensor, right: Tensor
) -> Tensor:
    """The number ``left``^T H ``right`` () for the definite ``elastic_hessian`` H and node vectors (V, 3), without the
    matrix; differentiable once more.
    """
    stretched = membrane.membrane_bilinear(
        model.triangles(x), rest.triangles, parameters.membrane, model.triangles(left), model.triangles(right)
    )
    stiffness_j, _ = _hinges(model, rest, parameters)
    bent = bending.bending_bilinear(model.hinges(x), stiffness_j, model.hinges(left), model.hinges(right))
    return stretched.sum() + bent.sum()


def _gradients(model: ClothModel, rest: Rest, parameters: Parameters, x: Tensor) -> list[Tensor]:
    """Derivatives [N] of ``elastic_energy`` by the corners of triangles (3, 3, F) and hinges (4, 3, H)."""
    return [
        membrane.membrane_gradient(model.triangles(x), rest.triangles, parameters.membrane),
        bending.bending_gradient(model.hinges(x), *_hinges(model, rest, parameters)),
    ]


def _hinges(model: ClothModel, rest: Rest, parameters: Parameters) -> tuple[Tensor, Tensor]:
    """Stiffness [J] and angle at rest [rad] (H,) of the hinges."""
    return parameters.bending_j * rest.hinge_weight, model.rest_angle


def _numpy(stacks: list[Tensor]) -> list[np.ndarray]:
    return [stack.detach().numpy() for stack in stacks]
