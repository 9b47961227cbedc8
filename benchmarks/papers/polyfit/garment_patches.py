"""Patches of garments: points sampled on the clusters of random partitions, with the mesh's normals.

Trained on: six designs and random neighbours of each. Held out: the garments of
DRAPE_DATA/garments, taken in and cached, or neighbours that training never draws where there is no such folder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from benchmarks.papers.polyfit.families import Patches
from drape.body.model import BodyModel
from drape.errors import InputError
from drape.files.data import data_folder
from drape.files.formats import MESH_SUFFIXES
from drape.garment.fitting import RestGarment, rest_garment
from drape.garment.intake import intake
from drape.garment.partition import partition, patch_count_for
from drape.garment.skin import BodyBinding
from training.garment_design import SIX, build, varied

HELD_OUT_SEED = 90_000
COUNT_RANGE = (0.7, 1.3)  # patch counts vary by these factors, so that sizes do


@dataclass(frozen=True)
class NamedGarment:
    """A garment at rest and its name."""

    name: str
    rest: RestGarment


def designed_garments(body: BodyModel, *, variants: int, seed: int) -> list[NamedGarment]:
    """The six designs and ``variants`` random neighbours of each."""
    rng = np.random.default_rng(seed)
    found = []
    for design in SIX:
        found.append(NamedGarment(design.name, rest_garment(*build(design, body), body)))
        for index in range(variants):
            found.append(NamedGarment(f"{design.name}_{index}", rest_garment(*varied(design, body, rng)[1:], body)))
    return found


def held_out_garments(body: BodyModel, *, folder: Path) -> tuple[list[NamedGarment], str]:
    """Garments that training never saw, and where they are from; intake caches go to ``folder``."""
    source = data_folder("garments")
    if source is None:
        rng = np.random.default_rng(HELD_OUT_SEED)
        drawn = [NamedGarment(f"{d.name}_held", rest_garment(*varied(d, body, rng)[1:], body)) for d in SIX]
        return drawn, "held-out variants of the six designs"
    found = []
    for path in sorted(p for p in source.iterdir() if p.suffix.lower() in MESH_SUFFIXES):
        if path.stem.startswith("avatar"):
            continue
        try:
            garment = intake(path, body=body, folder=folder)
        except InputError as error:
            print(f"left out: {error}")  # one bad file must not cost the run
            continue
        binding = BodyBinding(garment.skin_weights.astype(np.float64), garment.shapedirs.astype(np.float64))
        vertices = garment.vertices.astype(np.float64)
        found.append(
            NamedGarment(garment.name, RestGarment(vertices, garment.fine_faces.astype(np.int64), binding, body))
        )
    return found, "garments never trained on"


def draw_garment_patches(
    garments: Sequence[NamedGarment],
    *,
    partitions: int,
    point_count: int,
    seed: int,
    count_range: tuple[float, float] = COUNT_RANGE,
) -> Patches:
    """Patches of ``partitions`` random partitions of each garment, ``point_count`` points each."""
    rng = np.random.default_rng(seed)
    drawn = []
    for garment in garments:
        rest = garment.rest
        for _ in range(partitions):
            rule = patch_count_for(float(rest.areas.sum()))
            count = min(round(rule * rng.uniform(*count_range)), len(rest.vertices))
            label = partition(
                rest.vertices, rest.faces, rest.areas, count, seed=int(rng.integers(2**31)), graph=rest.graph
            )
            drawn.append(sample_patches(rest, label, point_count=point_count, rng=rng))
    points, normals = (torch.from_numpy(np.concatenate(parts)) for parts in zip(*drawn, strict=True))
    return Patches(points, normals)


def sample_patches(
    rest: RestGarment, label: np.ndarray, *, point_count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] (K, n, 3), uniform on the triangles of each cluster, and their interpolated unit normals, float32."""
    corner = label[rest.faces]
    # A triangle between clusters goes to the one that holds two of its corners.
    owner = np.where(corner[:, 1] == corner[:, 2], corner[:, 1], corner[:, 0])
    a, b, c = (rest.vertices[rest.faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    order = np.argsort(owner, kind="stable")
    total = np.concatenate([[0.0], np.cumsum(area[order])])
    bounds = np.searchsorted(owner[order], np.arange(label.max() + 2))
    low, high = total[bounds[:-1]], total[bounds[1:]]
    full = np.flatnonzero(high > low)
    at = low[full, None] + (high - low)[full, None] * rng.random((len(full), point_count))
    rank = np.clip(np.searchsorted(total, at, side="right") - 1, bounds[full, None], bounds[full + 1, None] - 1)
    face = order[rank]
    s, t = rng.random((2, *face.shape))
    flip = s + t > 1.0
    s, t = np.where(flip, 1.0 - s, s), np.where(flip, 1.0 - t, t)
    share = np.stack([1.0 - s - t, s, t], axis=-1)[..., None]
    corners = rest.faces[face]
    points = np.sum(share * rest.vertices[corners], axis=-2)
    normals = np.sum(share * rest.normals[corners], axis=-2)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    return points.astype(np.float32), normals.astype(np.float32)
