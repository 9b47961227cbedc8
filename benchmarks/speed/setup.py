"""What ``benchmarks.latency`` measures on: a model folder, garments of any vertex and patch count."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from drape.body.assets import load_body
from drape.garment.cache import GARMENTS_DIR, Garment, load_garment
from drape.garment.fitting import patch_fields, rest_garment
from drape.geometry import jets, meshes
from drape.motion.samples import SAMPLES
from training.exported import load_exported
from training.model import OneFit


def network_of(folder: Path) -> OneFit:
    """The network in torch whose graphs are in the model ``folder``."""
    weights, config, _ = load_exported(folder)
    model = OneFit(config).eval()
    model.load_state_dict(weights)
    return model


def shipped(name: str) -> Garment:
    """The shipped garment called ``name``."""
    return load_garment(next(iter(sorted(GARMENTS_DIR.glob(f"{name}-*.npz")))))


def shipped_names() -> list[str]:
    """Names of all shipped garments."""
    return sorted({path.name.rsplit("-", 1)[0] for path in GARMENTS_DIR.glob("*.npz")})


def poses(count: int) -> np.ndarray:
    """Poses (count, 24, 3) [rad], spread over the sample clips."""
    clips = [make().poses for make in SAMPLES.values()]
    every = np.concatenate(clips)
    return every[np.linspace(0, len(every) - 1, count).astype(int)]


def with_vertices(garment: Garment, count: int) -> Garment:
    """``garment`` with its mesh subdivided, and ``count`` of its vertices in the same patches.

    A new vertex takes patches and weights of a parent; its places in them are its own, so the surface is the same.
    """
    while garment.vertex_count < count:
        garment = _subdivided(garment)
    # The others stay behind them, as vertices of a subdivision do: the whole mesh says how the grain runs.
    shuffled = np.random.default_rng(0).permutation(garment.vertex_count)
    finer = np.arange(garment.vertex_count, len(garment.vertices))
    order = np.concatenate([np.sort(shuffled[:count]), np.sort(shuffled[count:]), finer])
    rows = {f.name: getattr(garment, f.name)[order] for f in fields(Garment) if f.name in _PER_VERTEX}
    fine_faces = np.argsort(order)[garment.fine_faces].astype(garment.fine_faces.dtype)
    return replace(garment, vertex_count=count, faces=garment.faces[:0], fine_faces=fine_faces, **rows)


_PER_VERTEX = ("vertices", "chart_patch", "chart_uv", "chart_weight", "chart_residual", "skin_weights", "shapedirs")


def _subdivided(garment: Garment) -> Garment:
    count = garment.vertex_count
    vertices, faces, parents = meshes.subdivide(garment.vertices[:count].astype(np.float64), garment.faces)
    first = parents[:, 0]  # of an old vertex: itself
    patch = garment.chart_patch[first]
    rotation = garment.patch_rotation[patch].astype(np.float64)
    local = np.einsum("vkba,vkb->vka", rotation, vertices[:, None] - garment.patch_centre[patch])
    scale = garment.patch_scale[patch].astype(np.float64)[..., None]
    uv = local[..., :2] / scale
    return replace(
        garment,
        vertex_count=len(vertices),
        vertices=vertices,
        faces=faces,
        fine_faces=faces,
        chart_patch=patch,
        chart_uv=uv,
        chart_weight=garment.chart_weight[first],
        chart_residual=local - scale * jets.evaluate(garment.patch_jet[patch].astype(np.float64), uv),
        skin_weights=garment.skin_weights[first],
        shapedirs=garment.shapedirs[first],
        # Panels and texture are of the triangles before; only speed is asked here.
        **dict.fromkeys(("rest_edges", "rest_angle", "rest_stiffening")),
        uv=garment.uv[:0],
        uv_faces=garment.uv_faces[:0],
    )


def with_patches(garment: Garment, count: int) -> Garment:
    """``garment`` covered anew by ``count`` patches."""
    rest = rest_garment(garment.vertices, garment.fine_faces, load_body())
    return replace(garment, **patch_fields(rest, count=count))
