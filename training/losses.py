"""Losses of training: the cloth's total energy on the posed body, and the disagreement of overlapping charts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from drape.cloth import energies
from drape.cloth.contact import nearest_body_vertices, plane_distance
from drape.cloth.material import Material
from drape.cloth.waistband import band_energy
from drape.graph.inputs import BodyTensors
from training.batches import BodyBatch, Partition, TrainingGarment
from training.chart_consensus import framewise_product
from training.onefit import FRAME_ROWS, paper_vertices


def vertices_from(coefficients: Tensor, partition: Partition) -> Tensor:
    """Returns vertices [m] (F, V, 3) relative to the root joint by one sparse product of ``onefit.posed_coefficients``
    (F, K, 19, 3); of variant "paper" in the rest pose. It equals ``onefit.vertex_positions``."""
    return framewise_product(partition.blend, coefficients.flatten(1, 2))


def garment_vertices(
    coefficients: Tensor, partition: Partition, garment: TrainingGarment, body: BodyTensors, *, variant: str
) -> Tensor:
    """Returns the posed vertices [m] (F, V, 3) relative to the root joint, of either ``variant``; ``coefficients``
    (F, K, 19, 3) are ``onefit.posed_coefficients``."""
    vertices = vertices_from(coefficients, partition)
    return paper_vertices(vertices, garment.skin_weights, body) if variant == "paper" else vertices


def chart_disagreement(coefficients: Tensor, partition: Partition, sample: Tensor) -> Tensor:
    """Returns the mean squared distance [m^2] () from a vertex to where each of its charts puts it, weighted as the
    charts are blended, over the vertices ``sample`` (n,).

    ``coefficients`` are ``onefit.posed_coefficients`` of a drape, or the difference of those of two drapes on the same
    bodies: then the result says how far the charts disagree on the displacement from one drape to the other.
    """
    patch = partition.chart_patch[sample]
    row = partition.chart_row[sample]
    weight = partition.chart_weight[sample]
    # Frames beside coordinates: one row of a chart times the numbers of all frames is a product worth its call.
    columns = coefficients.permute(1, 2, 3, 0).flatten(2)  # (K, 19, 3 F)
    gathered = torch.index_select(columns.flatten(1), 0, patch.reshape(-1)).unflatten(1, columns.shape[1:])
    places = (row.reshape(-1, 1, row.shape[-1]) @ gathered).reshape(*patch.shape, -1)  # (n, 4, 3 F)
    mean = (weight[..., None] * places).sum(dim=1, keepdim=True)
    return (weight[..., None] * (places - mean).square()).sum() / coefficients.shape[0] / len(sample)


def second_difference(vertices: Tensor) -> Tensor:
    """Returns the mean squared second difference in time [m^2] () of ``vertices`` [m] (3 n, V, 3), every three frames
    of which follow each other."""
    before, at, after = vertices.unflatten(0, (-1, 3)).unbind(dim=1)
    return (before - 2.0 * at + after).square().sum(dim=-1).mean()


def lost_area(vertices: Tensor, cloth: energies.ClothMesh) -> Tensor:
    """Returns for each frame (F,) the squared share of its rest area that a triangle lacks, as a mean over the cloth; a
    triangle that is larger than at rest costs nothing.

    Folds arrange the area that they are given. The membrane's energy charges so little for a few percent less that a
    network takes them, and folds then crumple what is left.
    """
    first, second, third = vertices[:, cloth.face_index].unflatten(1, (3, -1)).unbind(dim=1)
    area = 0.5 * torch.linalg.cross(second - first, third - first).norm(dim=-1)
    lack = torch.clamp(1.0 - area / cloth.face_area, min=0.0)
    return lack.square() @ (cloth.face_area / cloth.face_area.sum())


def waistband_energy(coefficients: Tensor, partition: Partition, garment: TrainingGarment) -> Tensor:
    """Returns the energy [J] (F,) of the garment's waistband (``drape.cloth.waistband``), zeros without one."""
    if garment.band is None:
        return coefficients.new_zeros(len(coefficients))
    vertex, length = garment.band
    # The band's home is where its charts carry it as rigid bodies; the jets, without the frames, move it from there.
    moved = nn.functional.pad(coefficients[..., FRAME_ROWS:, :], (0, 0, FRAME_ROWS, 0))
    patch = partition.chart_patch[vertex]
    row = partition.chart_weight[vertex][..., None] * partition.chart_row[vertex]  # (n, 4, 19)
    gathered = torch.index_select(moved.flatten(2), 1, patch.reshape(-1)).reshape(len(moved), len(vertex), -1, 3)
    return band_energy((row.reshape(1, len(vertex), 1, -1) @ gathered)[..., 0, :], length)


def soften(energy: Tensor, knee: float) -> Tensor:
    """Returns ``knee log(1 + e / knee)``: the energy itself while small, its logarithm where nothing can be done.

    Cloth between an arm and the trunk it lies in touches whatever the network does; without this such frames own the
    gradient.
    """
    return knee * torch.log1p(energy / knee)


@dataclass(frozen=True, eq=False)
class SampledPlanes:
    """Tangent planes of F bodies, ``point`` [m] and unit ``normal`` (F, n, 3), nearest to the garment's vertices with
    the indices ``sample`` (n,)."""

    sample: Tensor
    point: Tensor
    normal: Tensor


def contact_planes(vertices: Tensor, body: BodyBatch, *, share: float, generator: torch.Generator) -> SampledPlanes:
    """Returns the planes of the bodies nearest to a random ``share`` of ``vertices`` [m] (F, V, 3)."""
    count = vertices.shape[1]
    sample = torch.randperm(count, generator=generator)[: max(1, round(share * count))].to(vertices.device)
    touched = vertices.detach().index_select(1, sample)
    index = nearest_body_vertices(touched.cpu().numpy(), body.collider)
    frame = np.arange(len(index))[:, None]
    point = torch.from_numpy(body.collider[frame, index]).to(vertices.device)
    normal = torch.from_numpy(body.collider_normals[frame, index].astype(np.float32)).to(vertices.device)
    return SampledPlanes(sample, point, normal)


def energy_loss(
    vertices: Tensor, garment: TrainingGarment, planes: SampledPlanes, material: Material
) -> dict[str, Tensor]:
    """Returns the energy [J] (F,) of ``vertices`` [m] (F, V, 3) by part: membrane, bending, gravity and contact.

    Contact is that of the sample of ``planes``, scaled up: an unbiased estimate, since the search for nearest vertices
    is dear.
    """
    parts = energies.total(vertices, garment.cloth, material)
    touched = vertices.index_select(1, planes.sample)
    depth = torch.clamp(material.contact_gap_m - plane_distance(touched, planes.point, planes.normal), min=0.0)
    area = garment.cloth.vertex_area[planes.sample]
    scale = material.contact_j_m4 * vertices.shape[1] / len(planes.sample)
    parts["contact"] = scale * (area * depth.square()).sum(dim=-1)
    return parts
