"""The losses of OneFit (section 3, equations 2 to 7) on overlapping charts.

The published method cuts the garment into patches that touch; here charts overlap, so "points on the boundary
of two patches" are the vertices where two charts both say something. First and second fundamental forms are
analytic in the jets' coefficients. Every function works on any leading axes and in any float type.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from drape.cloth import energies
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.garment.charts import ChartBlend
from drape.garment.fitting import RestGarment, fit_jets
from drape.geometry import jets, meshes
from drape.graph.inputs import BodyTensors
from training.data import Partition
from training.model import Posed

STRETCH_DEPTH_M, STRETCH_EPOCHS = 0.01, 100.0  # of k_ext, under equation 3


# Section 4.1. The weight of the normals in equation 5 is not published: 1 makes 30 degrees count as 2 mm.
WEIGHTS = {"collision": 1.0, "metric": 0.5, "edges": 2.0, "boundary": 1.0, "gravity": 1.0}
GAP_WEIGHT, NORMAL_WEIGHT = 5e3, 1.0


# --- what the charts say --------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ChartSamples:
    """The charts of n vertices: ``vertex`` (n,), ``patch`` (n, 4), ``weight`` (n, 4), ``uv`` (n, 4, 2), ``place``
    (n, 4, 3) [m] the rest positions in the patch frames, ``scale`` (n, 4) [m], ``rest_jet`` (n, 4, 27)."""

    vertex: Tensor
    patch: Tensor
    weight: Tensor
    uv: Tensor
    place: Tensor
    scale: Tensor
    rest_jet: Tensor

    @cached_property
    def rest_metric(self) -> Tensor:
        """First fundamental form (n, 4, 2, 2) [m^2 per unit^2] of the rest jets."""
        return jets.metric(self.rest_jet, self.uv, self.scale)


def rest_jets(partition: Partition) -> Tensor:
    """The rest jets (K, 27) of a partition that training drew: in-plane the identity, heights fitted again."""
    patch, weight, row = (
        part.cpu().double().numpy() for part in (partition.chart_patch, partition.chart_weight, partition.chart_row)
    )
    patch = patch.astype(np.int64)
    height = row[..., 3] / partition.patches.scale.cpu().double().numpy()[patch]
    jet = fit_jets(row[..., 5:7], height, ChartBlend(patch, weight), len(partition.patches.scale))
    return torch.from_numpy(jet).to(partition.chart_row)


def chart_samples(partition: Partition, rest_jet: Tensor, vertex: Tensor) -> ChartSamples:
    """The charts of the vertices ``vertex`` (n,) int64; ``rest_jet`` (K, 27) as ``rest_jets`` gives it."""
    patch, row = partition.chart_patch[vertex], partition.chart_row[vertex]
    # A row is [1, place, polynomials]; the polynomials begin with 1, u, v.
    return ChartSamples(
        vertex=vertex,
        patch=patch,
        weight=partition.chart_weight[vertex],
        uv=row[..., 5:7],
        place=row[..., 1:4],
        scale=partition.patches.scale[patch],
        rest_jet=rest_jet[patch],
    )


@dataclass(frozen=True, eq=False)
class Skin:
    """Skinning of the vertices after the patches have moved, at n vertices and F bodies: bone ``weights`` (n, 24),
    their surface ``gradients`` (n, 24, 3) [1/m] in the rest pose, ``rotations`` (F, 24, 3, 3), ``translations``
    (F, 24, 3) [m]."""

    weights: Tensor
    gradients: Tensor
    rotations: Tensor
    translations: Tensor

    @classmethod
    def at(cls, vertex: Tensor, weights: Tensor, gradients: Tensor, body: BodyTensors) -> Skin:
        """Skinning of the vertices ``vertex`` (n,) of all (V, 24) and (V, 24, 3)."""
        return cls(weights[vertex], gradients[vertex], body.rotation, body.translation)

    def jacobian(self, points: Tensor) -> Tensor:
        """Derivative (F, n, m, 3, 3) of linear blend skinning at rest ``points`` [m] (F, n, m, 3).

        ``sum_j w_j R_j + (R_j x + t_j) (grad w_j)^T``: J_psi of OneFit, section 3.2.
        """
        matrices = torch.einsum("nj,fjab->fnab", self.weights, self.rotations)
        # sum_j (R_j x + t_j)_a (grad w_j)_b, without a tensor over all bones.
        turned = torch.einsum("njb,fjac->fnacb", self.gradients, self.rotations)
        shifted = torch.einsum("njb,fja->fnab", self.gradients, self.translations)
        along = torch.einsum("fnacb,fnmc->fnmab", turned, points)
        return (matrices + shifted)[:, :, None] + along

    def pose(self, points: Tensor) -> Tensor:
        """Posed points [m] (F, n, m, 3)."""
        matrices = torch.einsum("nj,fjab->fnab", self.weights, self.rotations)
        shift = torch.einsum("nj,fja->fna", self.weights, self.translations)
        return torch.einsum("fnab,fnmb->fnma", matrices, points) + shift[:, :, None]


def weight_gradients(rest: RestGarment) -> np.ndarray:
    """Gradients [1/m] (V, 24, 3) of the skin weights along the rest surface: those of its triangles, by area."""
    first, second = meshes.corner_edges(rest.vertices, rest.faces)
    area = np.cross(first, second)
    squared = np.maximum(np.sum(area * area, axis=1), 1e-30)[:, None]
    by_corner = [np.cross(second, area) / squared, np.cross(area, first) / squared]
    weights = rest.binding.weights[rest.faces]
    found = sum(
        (weights[:, k + 1] - weights[:, 0])[:, :, None] * gradient[:, None] for k, gradient in enumerate(by_corner)
    )
    size = np.sqrt(squared)[:, 0]
    total, mass = np.zeros((len(rest.vertices), weights.shape[2], 3)), np.zeros(len(rest.vertices))
    for k in range(3):
        np.add.at(total, rest.faces[:, k], size[:, None, None] * found)
        np.add.at(mass, rest.faces[:, k], size)
    return total / np.maximum(mass, 1e-30)[:, None, None]


@dataclass(frozen=True, eq=False)
class ChartSurface:
    """What each chart says of its vertices in F frames: ``positions`` [m] (F, n, 4, 3), ``tangents`` [m per unit]
    (F, n, 4, 3, 2) by u and v, ``jet`` (F, n, 4, 27) the whole jet in the patch frame."""

    positions: Tensor
    tangents: Tensor
    jet: Tensor

    @property
    def metric(self) -> Tensor:
        """First fundamental form (F, n, 4, 2, 2): g_P = s^2 J^T R^T J_psi^T J_psi R J (OneFit, section 3.2)."""
        return self.tangents.mT @ self.tangents

    @property
    def normals(self) -> Tensor:
        """Unit normals (F, n, 4, 3)."""
        normal = torch.linalg.cross(self.tangents[..., 0], self.tangents[..., 1])
        return normal / torch.sqrt(normal.square().sum(dim=-1, keepdim=True) + 1e-30)


def chart_surface(posed: Posed, samples: ChartSamples, *, skin: Skin | None = None) -> ChartSurface:
    """The posed charts of ``samples``; with ``skin`` the patches moved in the rest pose and are skinned after."""
    added = posed.jet[:, samples.patch]
    rotation, centre = posed.rotation[:, samples.patch], posed.centre[:, samples.patch]
    scale, jet = samples.scale[..., None], jets.full(samples.rest_jet) + jets.full(added)
    local = samples.place + scale * jets.evaluate(added, samples.uv)
    positions = centre + (rotation @ local[..., None])[..., 0]
    by_u, by_v = jets.evaluate(jet, samples.uv, u_times=1), jets.evaluate(jet, samples.uv, v_times=1)
    tangents = rotation @ (scale[..., None] * torch.stack([by_u, by_v], dim=-1))
    if skin is None:
        return ChartSurface(positions, tangents, jet)
    return ChartSurface(skin.pose(positions), skin.jacobian(positions) @ tangents, jet)


# --- equations 2 to 7 -----------------------------------------------------------------------------------------------


def collision_depth(distance: Tensor, gap_m: float) -> Tensor:
    """d_c = max(gap - d, 0) [m] of signed distances ``distance`` [m], outside positive (equation 2)."""
    return torch.clamp(gap_m - distance, min=0.0)


def collision(depth: Tensor) -> Tensor:
    """The sum of d_c^2 [m^2] over the points (..., n): equation 2 without its weight, which grows with their number."""
    return depth.square().sum(dim=-1)


def allowed_stretch(depth: Tensor, epoch: float) -> Tensor:
    """k_ext = 1 + min(d_c, 0.01) min(e, 100), under equation 3: cloth that collides may be longer, up to twice."""
    return 1.0 + torch.clamp(depth, max=STRETCH_DEPTH_M) * min(epoch, STRETCH_EPOCHS)


def metric_inextensibility(metric: Tensor, rest_metric: Tensor, stretch: Tensor, weight: Tensor) -> Tensor:
    """Equation 3 without its weight: the mean of |k_ext g_T - g_P| over the points, summed over the 4 entries.

    ``metric`` (..., n, 4, 2, 2) and ``rest_metric`` (n, 4, 2, 2) of each chart, ``stretch`` (..., n), ``weight``
    (n, 4) the charts' in the blend, whose sum is one: a point counts once, however many charts hold it.
    """
    off = (stretch[..., None, None, None] * rest_metric - metric).abs().sum(dim=(-2, -1))
    return (weight * off).sum(dim=-1).mean(dim=-1)


def edge_inextensibility(vertices: Tensor, edges: Tensor, lengths_rest: Tensor) -> Tensor:
    """Equation 4 without its weight: the sum over edges of (e - e_rest)^2 [m^2].

    ``vertices`` [m] (..., V, 3), ``edges`` (2, E) int64, ``lengths_rest`` [m] (E,). Halving all edges leaves it as it
    is: four times the edges, each off by half.
    """
    planes = vertices.movedim(-1, 0)  # gathers along the last axis are the fast ones
    between = planes.index_select(-1, edges[1]) - planes.index_select(-1, edges[0])
    length = torch.sqrt(between.square().sum(dim=0) + 1e-16)
    return (length - lengths_rest).square().sum(dim=-1)


def boundary(surface: ChartSurface, weight: Tensor) -> Tensor:
    """The mean over points of k_b |x_i - x_j|^2 + k_bn (1 - cos)^2, (F,): equation 5.

    i and j are the two heaviest charts of a point (``weight`` (n, 4), heaviest first); a point that only one chart
    holds does not count.
    """
    shared = (weight[:, 1] > 0).to(weight.dtype)
    gap = (surface.positions[:, :, 0] - surface.positions[:, :, 1]).square().sum(dim=-1)
    normals = surface.normals
    cosine = (normals[:, :, 0] * normals[:, :, 1]).sum(dim=-1)
    apart = GAP_WEIGHT * gap + NORMAL_WEIGHT * (1.0 - cosine).square()
    return (shared * apart).sum(dim=-1) / shared.sum().clamp(min=1.0)


def gravity(vertices: Tensor, cloth: ClothMesh, material: Material) -> Tensor:
    """Equation 7: -m g^T x [J], summed over the vertices."""
    return energies.gravity(vertices, cloth, material)
