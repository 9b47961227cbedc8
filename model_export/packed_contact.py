"""What the patches of the packed graph feel of their bodies: ``drape.cloth.push.patches`` with bodies mixed."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from drape.cloth.push.field import mixed, queries
from drape.cloth.push.out import REGION_BIAS_M2, REGION_COUNT
from drape.cloth.push.patches import (
    Planes,
    felt,
    from_halves,
    mixed_others,
    region_bias_of,
    tangent_planes,
)
from drape.cloth.push.samples import CLUSTER_SIZE, REGION_SIZE, region_centres
from drape.cloth.push.skin import skin_table
from drape.geometry import jets
from training.agreement import softened


@dataclass(frozen=True)
class Skins:
    """Inputs of ``PackedGraph`` by which its bodies have a skin: of U shapes, and the shape of each body."""

    rows: Tensor  # (U, parts, n, 4, 144)
    bones: Tensor
    shape: Tensor


@dataclass(frozen=True)
class Felt:
    """Inputs of ``PackedGraph`` by which patches feel it, gathered for its patches."""

    place: Tensor  # (P, 3, 7) [patch scales]
    cluster: Tensor  # (P, 10)
    bias: Tensor  # (P, 40)
    other: Tensor  # (P, parts, 24)
    region: Tensor  # (P, parts, 4)


def posed_skins(skins: Skins, rotation: Tensor, translation: Tensor) -> Tensor:
    """Tables (B, R, 12, 8) of the skins of bodies with these bones."""
    return skin_table(torch.index_select(skins.rows, 0, skins.shape), skins.bones, rotation, translation)


def near_planes(points: Tensor, skin: Tensor, lists: Felt, patch_body: Tensor) -> Planes:
    """Planes near ``points`` [m] (P, 3, 7) on the bodies ``patch_body`` (P,), which have ``skin`` (B, R, 12, 8)."""
    bodies, regions = skin.shape[0], skin.shape[1]
    places = points.mT  # (P, 7, 3)
    query = queries(places)
    body = patch_body.to(torch.int64)
    clusters = skin.reshape(-1, 8 * CLUSTER_SIZE)
    first = body * (regions * (REGION_SIZE // CLUSTER_SIZE))
    own = torch.index_select(clusters, 0, (lists.cluster.to(torch.int64) + first[:, None]).reshape(-1))
    own_means = mixed(query, own.reshape(-1, lists.bias.shape[1], 8), lists.bias)

    region = region_centres(skin)
    rows = torch.cat([-2.0 * region, (region * region).sum(dim=-1, keepdim=True)], dim=-1).reshape(bodies, -1)
    seen = torch.index_select(rows, 0, body).reshape(-1, regions, 4)
    centre = torch.cat([places.mean(dim=1), torch.ones_like(places[:, 0, :1])], dim=1)  # (P, 4)
    squared = (seen @ centre[:, :, None]).reshape(-1, regions)
    bias = region_bias_of(lists.region.reshape(-1, regions).to(places.dtype))
    top = torch.topk(REGION_BIAS_M2 * bias - squared, REGION_COUNT, dim=-1, sorted=False)[1]
    table = torch.index_select(skin.reshape(-1, 8 * REGION_SIZE), 0, (top + (regions * body)[:, None]).reshape(-1))
    # 0, 1, 2, ... counted out: the number of patches would be read off an index that a call of one garment lacks.
    patch = regions * (torch.cumsum(torch.ones_like(body), dim=0) - 1)
    row = (top + patch[:, None]).reshape(-1)
    other = torch.index_select(lists.other.reshape(-1, REGION_SIZE // 2), 0, row).to(places.dtype)
    count = REGION_COUNT * REGION_SIZE
    other_means = mixed_others(query, table.reshape(-1, count, 8), from_halves(other).reshape(-1, count))
    return tangent_planes(places[None], own_means[None], other_means[None])


def felt_inputs(points: Tensor, near: Planes, rotation: Tensor, terms: Tensor) -> list[Tensor]:
    """Closeness (P, 14) and force on the jets (P, 27) as ``training.model.OneFit`` gives them to its corrections.

    ``points`` (P, 3, 7) [m], frames ``rotation`` (P, 3, 3), ``terms`` (7, 15) the basis at the points.
    """
    closeness, push = felt(points.mT[None], near)
    along = rotation.mT @ (push[0].mT @ terms)  # (P, 3, 15)
    plane = along[:, :2, : jets.IN_PLANE_COUNT].reshape(-1, 2 * jets.IN_PLANE_COUNT)
    return [closeness[0], softened(torch.cat([plane, along[:, 2]], dim=-1) / 4.0)]
