"""Small garments with closed forms, and the derivative checks of the simulator's tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from drape.cloth.material import OrthotropicMaterial
from recovery.sim.cloth_model import ClothModel, ClothState, Parameters, Rest
from recovery.sim.implicit import linearised_step
from recovery.sim.newton_steps import TOLERANCE_N, newton_step
from recovery.sim.skin_contact import SkinContact

# A woven cloth of ordinary stiffness, every constant different so that a swap shows.
WOVEN = OrthotropicMaterial(h00=60.0, h01=11.0, h11=45.0, h22=24.0, bending_j=1.5e-4, density_kg_m2=0.18)


def strip(columns: int, rows: int, *, length_m: float, width_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Panel vertices (P, 2) and faces of a rectangle along x, its right triangles with alternating diagonals."""
    x, y = np.meshgrid(np.linspace(0, length_m, columns + 1), np.linspace(0, width_m, rows + 1), indexing="ij")
    faces = []
    for i in range(columns):
        for j in range(rows):
            a, b = i * (rows + 1) + j, (i + 1) * (rows + 1) + j
            if (i + j) % 2:
                faces += [[a, b, b + 1], [a, b + 1, a + 1]]
            else:
                faces += [[a, b, a + 1], [b, b + 1, a + 1]]
    return np.stack([x.ravel(), y.ravel()], axis=1), np.array(faces)


def lifted(panels: np.ndarray, *, y_m: float = 0.0) -> np.ndarray:
    """The panel laid flat in the horizontal plane at height ``y_m``, its normals up."""
    return np.stack([panels[:, 0], np.full(len(panels), y_m), -panels[:, 1]], axis=1)


def sewn_tube(columns: int = 4, rows: int = 3, **settings) -> tuple[ClothModel, np.ndarray, np.ndarray]:
    """Two panels sewn along both sides into a flat tube: the model, panels (P, 2) and nodes (V, 3).

    The back panel is mirrored, as the texture coordinates of garments often are.
    """
    panel, faces = strip(columns, rows, length_m=0.2, width_m=0.15)
    side = (panel[:, 0] == 0.0) | (panel[:, 0] == panel[:, 0].max())
    node_of_back = np.where(side, np.arange(len(panel)), len(panel) + np.cumsum(~side) - 1)
    front = np.stack([panel[:, 0], panel[:, 1], np.where(side, 0.0, 0.04)], axis=1)
    back = front[~side] * [1.0, 1.0, -1.0]
    mirrored = panel * [-1.0, 1.0] + [0.5, 0.0]
    model = ClothModel(
        np.concatenate([faces, node_of_back[faces[:, ::-1]]]),
        panel_faces=np.concatenate([faces, len(panel) + faces[:, ::-1]]),
        **settings,
    )
    return model, np.concatenate([panel, mirrored]), np.concatenate([front, back])


def crumpled(model: ClothModel, nodes: np.ndarray, *, size_m: float = 0.004, seed: int = 0) -> ClothState:
    """``nodes`` moved at random by ``size_m``, with random velocities of 0.1 m/s."""
    rng = np.random.default_rng(seed)
    free = ~model.fixed[:, None]
    return model.state(nodes + free * rng.normal(size=nodes.shape) * size_m, free * rng.normal(size=nodes.shape) * 0.1)


class Crumpled(NamedTuple):
    """A crumpled tube of ``WOVEN`` at the nodes ``x``: everything that its energies take."""

    model: ClothModel
    panels: np.ndarray
    parameters: Parameters
    rest: Rest
    x: Tensor


def crumpled_tube(**settings) -> Crumpled:
    """The tube of ``sewn_tube``, crumpled."""
    model, panels, nodes = sewn_tube(**settings)
    parameters = model.parameters(panels, WOVEN)
    return Crumpled(model, panels, parameters, model.rest(parameters.panels), crumpled(model, nodes).x)


def advance(
    method: str,
    model: ClothModel,
    state: ClothState,
    parameters: Parameters,
    *,
    dt_s: float,
    steps: int,
    contact: SkinContact | None = None,
    tolerance_n: float = TOLERANCE_N,
) -> ClothState:
    """``state`` after ``steps`` by ``method``, "linearised" or "newton", which is solved to ``tolerance_n``."""
    for _ in range(steps):
        if method == "linearised":
            state = linearised_step(model, state, parameters, dt_s=dt_s, contact=contact)
        else:
            state, _ = newton_step(model, state, parameters, dt_s=dt_s, contact=contact, tolerance_n=tolerance_n)
    return state


def leaves_of(state: ClothState, parameters: Parameters) -> dict[str, Tensor]:
    """Everything that can be differentiated by, by name."""
    return {**state._asdict(), **parameters._asdict()}


def with_leaf(state: ClothState, parameters: Parameters, name: str, value: Tensor) -> tuple[ClothState, Parameters]:
    """Both, the leaf ``name`` replaced."""
    if name in state._fields:
        return state._replace(**{name: value}), parameters
    return state, parameters._replace(**{name: value})


def directional_error(
    loss: Callable[[ClothState, Parameters], Tensor],
    state: ClothState,
    parameters: Parameters,
    name: str,
    *,
    step: float,
    seed: int = 1,
    free: Tensor | None = None,
) -> float:
    """Relative error of the gradient by leaf ``name`` against central differences in a random direction.

    ``step`` is relative to the leaf's size. The direction shares the gradient's sign pattern in part, so
    that the derivative is not a small difference of large parts.
    """
    leaf = leaves_of(state, parameters)[name].clone().requires_grad_(True)
    (gradient,) = torch.autograd.grad(loss(*with_leaf(state, parameters, name, leaf)), leaf)
    generator = torch.Generator().manual_seed(seed)
    direction = torch.randn(leaf.shape, generator=generator, dtype=torch.float64)
    direction = direction.abs() * torch.where(gradient < 0.0, -1.0, 1.0)
    if free is not None:
        direction = direction * free
    scale = step * {"x": 0.1, "v": 0.1, "panels": 0.1, "force_n": 1e-3}.get(name, float(leaf.detach().abs().max()))
    with torch.no_grad():
        plus, minus = (
            loss(*with_leaf(state, parameters, name, leaf + sign * scale * direction)) for sign in (1.0, -1.0)
        )
    numeric = float(plus - minus) / (2.0 * scale)
    return abs(float((gradient * direction).sum()) - numeric) / abs(numeric)
