"""From a garment at rest on the body to patches, charts and jets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse

from drape.body.model import BodyModel
from drape.cloth.fabric_table import DEFAULT_FABRIC
from drape.forked import each
from drape.garment import charts, patch_features, skin
from drape.garment.cache import Atlas, Garment
from drape.garment.files.mesh import GarmentMesh
from drape.garment.mantle_shapes import ways_to
from drape.garment.partition import partition, patch_count_for, vertex_graph
from drape.garment.unfold import fit_planes, folded_charts, folded_triangles, without_folds
from drape.geometry import jets, meshes

CHART_RADIUS = 1.2  # patch scale over sqrt(area per patch): |u|, |v| <= 1 over most of a chart
DEFAULT_SEED = 0


@dataclass(frozen=True, eq=False)
class RestSurface:
    """A mesh at rest: ``vertices`` [m] (N, 3) in the body's frame, and ``faces`` (G, 3), those of a garment's
    subdivided mesh."""

    vertices: np.ndarray
    faces: np.ndarray

    @cached_property
    def normals(self) -> np.ndarray:
        """Returns the unit normals (N, 3) of the vertices, weighted by area."""
        total = np.zeros_like(self.vertices)
        for k in range(3):
            np.add.at(total, self.faces[:, k], self._face_cross)
        return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)

    @cached_property
    def _face_cross(self) -> np.ndarray:
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a)

    @cached_property
    def areas(self) -> np.ndarray:
        """Returns for each vertex a third of the area [m^2] (N,) of the triangles around it, at least 1e-12."""
        face_area = 0.5 * np.linalg.norm(self._face_cross, axis=1)
        total = np.zeros(len(self.vertices))
        for k in range(3):
            np.add.at(total, self.faces[:, k], face_area / 3.0)
        return np.maximum(total, 1e-12)

    @cached_property
    def graph(self) -> scipy.sparse.csr_matrix:
        """Returns the sparse symmetric matrix (N, N) of the lengths [m] of edges, and of the diagonals across each
        edge."""
        return vertex_graph(self.vertices, self.faces)


@dataclass(frozen=True, eq=False)
class RestGarment(RestSurface):
    """A garment's mesh at rest on ``body`` with what does not depend on its partition: ``binding`` has its bone weights
    and its movement with the body's shape."""

    binding: skin.BodyBinding
    body: BodyModel


def rest_garment(
    vertices: np.ndarray, faces: np.ndarray, body: BodyModel, *, arm: np.ndarray | None = None
) -> RestGarment:
    """Returns the mesh of ``vertices`` [m] (N, 3) and ``faces`` (G, 3), at rest on ``body`` in T-pose, bound to the
    body. ``arm`` (N,) as in ``bind_to_body``."""
    vertices = np.asarray(vertices, dtype=np.float64)
    return RestGarment(vertices, faces, skin.bind_to_body(vertices, faces, body, arm=arm), body)


def patch_fields(
    rest: RestGarment,
    *,
    count: int | None = None,
    share: float = 1.0,
    seed: int = DEFAULT_SEED,
    unfold: bool = False,
    like: Atlas | None = None,
    label: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """Returns the fields of an ``Atlas`` by their names, for one partition of ``rest``; float32, indices int32.

    The partition is that of ``like``, the same cloth on another body; else ``label`` (N,), the patch of each vertex;
    else a new one, drawn by ``seed``, into ``count`` patches, by default ``share`` times ``patch_count_for`` of the
    area.

    ``unfold`` lays charts flat that fold over (``drape.garment.unfold``). ``patch_features`` are those of the
    projection either way, because training draws partitions without unfolding.
    """
    area = float(rest.areas.sum())
    alike = None if like is None else _label_of(like)
    if alike is None:
        like, alike = None, patch_labels(rest, count, share, seed) if label is None else label
    label = alike
    centre, seeds = charts.cluster_centres(label, rest.vertices, rest.areas)
    count = len(centre)
    weights = _cluster_mean(label, rest.areas, rest.binding.weights, count)
    moves = rest.binding.shapedirs.reshape(len(label), -1)
    shapedirs = _cluster_mean(label, rest.areas, moves, count).reshape(count, 3, -1)
    rotation = charts.patch_frames(label, rest.normals, rest.areas, weights @ rest.body.bone_directions)
    scale = np.full(count, CHART_RADIUS * np.sqrt(area / count))
    blend = _blend_of(like) if like else charts.blend_charts(rest.graph, seeds, spacing_m=float(np.sqrt(area / count)))
    local = np.einsum("vkba,vkb->vka", rotation[blend.patch], rest.vertices[:, None] - centre[blend.patch])
    uv, height = local[..., :2] / scale[blend.patch][..., None], local[..., 2] / scale[blend.patch]
    jet = projected = fit_jets(uv, height, blend, count)
    if unfold:
        flat = without_folds(blend, local, scale, rest.faces, like)
        blend, uv = flat.blend, flat.uv
        jet = fit_planes(fit_jets(uv, height, blend, count), flat, local, scale)
    residual = local - scale[blend.patch][..., None] * jets.evaluate_jet(jet[blend.patch], uv)
    pairs = np.sort(label[meshes.unique_edges(rest.faces)], axis=1)
    return {
        "patch_rotation": rotation.astype(np.float32),
        "patch_centre": centre.astype(np.float32),
        "patch_scale": scale.astype(np.float32),
        "patch_jet": jet.astype(np.float32),
        "patch_weights": weights.astype(np.float32),
        "patch_shapedirs": shapedirs.astype(np.float32),
        "patch_features": patch_features.patch_features(
            centre=centre, rotation=rotation, scale=scale, jet=projected, weights=weights, seeds=seeds,
            vertices=rest.vertices, faces=rest.faces, graph=rest.graph, body=rest.body,
        ),
        "patch_neighbours": np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0).astype(np.int32),
        "chart_patch": blend.patch,
        "chart_uv": uv.astype(np.float32),
        "chart_weight": blend.weight.astype(np.float32),
        "chart_residual": residual.astype(np.float32),
    }  # fmt: skip


def patch_labels(
    rest: RestSurface, count: int | None = None, share: float = 1.0, seed: int = DEFAULT_SEED
) -> np.ndarray:
    """Returns the patch (N,) int of each vertex of ``rest`` in a new partition, drawn by ``seed``, into ``count``
    patches; by default ``share`` times ``patch_count_for`` of the area."""
    count = min(patch_count_for(float(rest.areas.sum()), share) if count is None else count, len(rest.vertices))
    return partition(rest.vertices, rest.faces, rest.areas, count, seed=seed, graph=rest.graph)


def _blend_of(like: Atlas) -> charts.ChartBlend:
    return charts.ChartBlend(like.chart_patch, like.chart_weight.astype(np.float64))


def _label_of(like: Atlas) -> np.ndarray | None:
    """The patch (N,) in which each vertex weighs most; None where a patch has none then."""
    label = np.take_along_axis(like.chart_patch, like.chart_weight.argmax(axis=1)[:, None], axis=1)[:, 0]
    return label if len(np.unique(label)) == like.patch_count else None


def _cluster_mean(label: np.ndarray, area: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    collect = scipy.sparse.csr_matrix((area, (label, np.arange(len(label)))), shape=(count, len(label)))
    return (collect @ values) / np.bincount(label, area, count)[:, None]


def fit_jets(uv: np.ndarray, height: np.ndarray, blend: charts.ChartBlend, count: int) -> np.ndarray:
    """Returns the rest jets (K, 27) of ``count`` patches [patch scales]: in the plane the identity, in height a ridge
    least-squares 4-jet (Cazals and Pouget 2003). ``uv`` (N, 4, 2) and ``height`` (N, 4) are the places of vertices in
    their charts [patch scales]; they weigh as in ``blend``."""
    basis = jets.basis(uv, jets.HEIGHT_ORDER).reshape(-1, jets.HEIGHT_COUNT)
    height, root = height.reshape(-1), np.sqrt(blend.weight).reshape(-1)
    jet = np.zeros((count, jets.JET_COUNT))
    jet[:, 1] = 1.0  # p = u
    jet[:, jets.IN_PLANE_COUNT + 2] = 1.0  # q = v
    owner = np.where(blend.weight > 0, blend.patch, -1).reshape(-1)
    for k, rows in enumerate(charts.rows_of_patches(owner, count)):
        jet[k, 2 * jets.IN_PLANE_COUNT :] = charts.ridge_fit(basis[rows], height[rows], root[rows])
    return jet


def fit_error(rest: RestGarment, fields: dict[str, np.ndarray]) -> dict[str, float]:
    """Returns how well the blended jets of ``fields`` (``patch_fields``), without residual, follow the mesh ``rest``.
    ``point_rmse_m`` and ``point_max_m`` [m]: distances of vertices. ``normal_error_deg`` [deg]: the mean angle between
    normals (OneFit, table 7).

    Three numbers count fold-over. ``folded_chart_triangles``, triangles upside down in (u, v), and ``folded_charts``,
    charts that are no bijections, are zero after intake. ``folded_chart_entries`` counts pairs of a vertex and one of
    its charts where the normal of the jet points below the patch's plane. No projection has such pairs; a chart that
    was laid flat may, if cloth bends that far.
    """
    patch = fields["chart_patch"]
    uv, weight = fields["chart_uv"].astype(np.float64), fields["chart_weight"].astype(np.float64)
    jet, scale = fields["patch_jet"].astype(np.float64), fields["patch_scale"].astype(np.float64)
    rotation = fields["patch_rotation"].astype(np.float64)
    local = scale[patch][..., None] * jets.evaluate_jet(jet[patch], uv)
    placed = np.einsum("vkab,vkb->vka", rotation[patch], local) + fields["patch_centre"][patch]
    point_error = np.linalg.norm(np.einsum("vk,vka->va", weight, placed) - rest.vertices, axis=1)
    tilted = np.einsum("vkab,vkb->vka", rotation[patch], jets.normal(jet[patch], uv))
    normal = np.einsum("vk,vka->va", weight, tilted)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    cosine = np.clip(np.sum(normal * rest.normals, axis=1), -1.0, 1.0)
    folded = (jets.normal(jet[patch], uv)[..., 2] <= 0) & (weight > 0)
    blend = charts.ChartBlend(patch, weight)
    return {
        "point_rmse_m": float(np.sqrt(np.mean(point_error**2))),
        "point_max_m": float(point_error.max()),
        "normal_error_deg": float(np.degrees(np.arccos(cosine)).mean()),
        "folded_chart_entries": int(folded.sum()),
        "folded_chart_triangles": int(folded_triangles(blend, uv, rest.faces).sum()),
        "folded_charts": int(folded_charts(blend, uv, rest.faces).sum()),
    }


def fit_garment(
    mesh: GarmentMesh,
    vertices: np.ndarray,
    fine_faces: np.ndarray,
    body: BodyModel,
    *,
    digest: str,
    manifest: dict[str, Any],
    count: int | None = None,
    share: float = 1.0,
    like: Atlas | None = None,
    arm: np.ndarray | None = None,
    shapes: np.ndarray | None = None,
) -> Garment:
    """Returns the garment of ``mesh`` at rest on ``body``, with patches and charts. It has no rest state, the default
    fabric, and None for ``drawn``. Its manifest is ``manifest`` and under "fit" what ``fit_error`` returns,
    "patch_count" and "area_m2".

    ``vertices`` [m] (N, 3): the rest positions of the vertices of ``mesh``, then of those that subdivision added;
    ``fine_faces`` (G, 3): the subdivided triangles. ``count``, ``share`` and ``like`` as in ``patch_fields``, ``arm``
    as in ``bind_to_body``. ``shapes`` [m] (6, N, 3): the vertices of a mantle over arms along each of
    ``mantle_shapes.DIRECTIONS``; None for other cloth.
    """
    surface = RestSurface(np.asarray(vertices, dtype=np.float64), fine_faces)
    makes: list[Callable[[], Any]] = [lambda: skin.bind_to_body(surface.vertices, fine_faces, body, arm=arm)]
    if like is None:
        makes.append(lambda: patch_labels(surface, count, share))
    binding, *labels = each(lambda make: make(), makes)
    rest = RestGarment(surface.vertices, fine_faces, binding, body)
    fields = patch_fields(rest, count=count, share=share, unfold=True, like=like, label=next(iter(labels), None))
    garment = Garment(
        name=mesh.name,
        digest=digest,
        body_digest=body.digest,
        vertex_count=len(mesh.vertices),
        vertices=rest.vertices.astype(np.float32),
        faces=mesh.faces.astype(np.int32),
        fine_faces=np.asarray(fine_faces, dtype=np.int32),
        uv=mesh.uv.astype(np.float32),
        uv_faces=mesh.uv_faces.astype(np.int32),
        material_names=mesh.material_names,
        face_material=mesh.face_material.astype(np.int32),
        manifest={},
        fabric=DEFAULT_FABRIC,
        drawn=None,
        looks=mesh.looks,
        arm_share=None if arm is None else arm.astype(np.float32),
        arm_ways=None if shapes is None else ways_to(shapes, rest.vertices, rest.binding, body).astype(np.float32),
        **fields,
    )
    figures = fit_error(rest, fields) | {"patch_count": garment.patch_count, "area_m2": float(rest.areas.sum())}
    return replace(garment, manifest=manifest | {"fit": figures})
