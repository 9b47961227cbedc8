"""A garment in the sizes that it was not sewn in: what is stored of them, and how they are made of its M.

A size has the mesh, the seams, the patches and the charts of M. ``SizeTable`` holds, of a few vertices, how far they
lie from where M's do on the standard body, and of a few corners of the panels how far these have grown. Between them
both fields are splines: |x| in space, since cloth is cut by seams, and thin plates in each panel, which give back what
is linear. Folds of the T-pose that one size has and another has not are left out: folds are grown anew in every frame.

``python -m recovery.catalogue grade`` writes the tables.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drape.body.model import BodyModel
from drape.errors import ArtifactError
from drape.files.atomic import whole_file
from drape.files.packed import UNREADABLE, pack, read_packed
from drape.garment.cache import Garment
from drape.garment.charts import ChartBlend
from drape.garment.clearance import clear_body
from drape.garment.ease import eases, girth_around
from drape.garment.fitting import fit_jets
from drape.garment.partition import vertex_graph
from drape.garment.patch_features import patch_features
from drape.garment.size_chart import SIZES
from drape.garment.unfold import Flattened, fit_planes
from drape.geometry import jets, mesh_graphs, meshes
from drape.geometry.closest import nearest_vertices

FOLDER = "sizes"  # a folder beside the garments
FORMAT_VERSION = 1
MOVED_STEP_M, GROWN_STEP_M = 5e-4, 5e-5
OTHERS = tuple(size for size in SIZES if size != "M")


@dataclass(frozen=True, eq=False)
class SizeTable:
    """The sizes S, L and XL (``OTHERS``) of the garment with ``digest``, as differences from its M. ``moved`` [m] (3,
    A, 3): displacements of the vertices ``vertex`` (A,) on the standard body. ``grown`` [m] (3, B, 2): displacements of
    the rows ``corner`` (B,) of the uv, which are panels in metres. ``measures``: for each size, M included, what
    ``garment_measures`` returns."""

    digest: str
    vertex: np.ndarray
    moved: np.ndarray
    corner: np.ndarray
    grown: np.ndarray
    measures: Mapping[str, Mapping[str, float]]


def table_path(folder: Path, garment: Garment) -> Path:
    """Returns the path of the size table of ``garment`` in the ``folder`` of garments; the file need not be there."""
    return folder / FOLDER / garment.file_name()


def save_table(table: SizeTable, path: Path) -> None:
    """Writes ``table`` to ``path``, atomically. Displacements are rounded to half a millimetre for vertices and to 50
    micrometres for panels."""
    header = {"format_version": FORMAT_VERSION, "digest": table.digest, "measures": table.measures}
    content = pack(
        {
            "header": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8),
            "vertex": table.vertex.astype(np.uint16),
            "moved": np.rint(table.moved / MOVED_STEP_M).astype(np.int16),
            "corner": table.corner.astype(np.uint16),
            "grown": np.rint(table.grown / GROWN_STEP_M).astype(np.int16),
        }
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as file:
        file.write(content)


def load_table(path: Path, garment: Garment) -> SizeTable:
    """Returns the size table stored at ``path``; raises ``ArtifactError`` if it is damaged or belongs to another
    garment."""
    label, cure = f"sizes {path.name}", "Run python -m recovery.catalogue grade."
    try:
        header, arrays = read_packed(path)
        table = SizeTable(
            header["digest"],
            arrays["vertex"].astype(np.int64),
            MOVED_STEP_M * arrays["moved"].astype(np.float64),
            arrays["corner"].astype(np.int64),
            GROWN_STEP_M * arrays["grown"].astype(np.float64),
            header["measures"],
        )
    except UNREADABLE as error:
        raise ArtifactError(label, expected="a table of sizes", got=str(error), cure=cure) from error
    if (header.get("format_version"), table.digest) != (FORMAT_VERSION, garment.digest):
        raise ArtifactError(label, expected=f"sizes of {garment.digest[:12]}", got=table.digest[:12], cure=cure)
    return table


def sized_digest(garment: Garment, table: SizeTable, size: str) -> str:
    """Returns the hex digest of what ``sized`` makes of ``garment`` in ``size``."""
    numbers = b"".join(
        np.ascontiguousarray(a).tobytes() for a in (table.vertex, table.moved, table.corner, table.grown)
    )
    return hashlib.sha256(f"size {FORMAT_VERSION} {garment.digest} {size} ".encode() + numbers).hexdigest()


def sized(garment: Garment, body: BodyModel, table: SizeTable, size: str) -> Garment:
    """Returns ``garment``, which is the size M, in ``size`` (``SIZES``), clear of the skin of ``body``, on which it was
    sewn. For M that is ``garment`` itself. It takes seconds, most of them for the push out of the skin. Raises
    ``MeshError`` where the cloth cannot be brought clear."""
    if size == "M":
        return garment
    number = OTHERS.index(size)
    faces, standing = garment.fine_faces.astype(np.int64), garment.vertices.astype(np.float64)
    moved = standing + field_in_space(standing, table.vertex, table.moved[number])
    uv = garment.uv.astype(np.float64)
    graded = uv + field_in_panels(uv, garment.uv_faces, table.corner, table.grown[number])
    rest = garment.rest_state()
    cleared = clear_body(moved, faces, body.v_template, body.faces).vertices
    edges = regraded(rest.edges, uv, graded, garment.uv_faces)
    return replace(
        garment,
        digest=sized_digest(garment, table, size),
        vertices=cleared.astype(np.float32),
        uv=graded.astype(np.float32),
        rest_edges=edges.astype(np.float32),
        rest_angle=rest.hinge_angle.astype(np.float32),
        rest_stiffening=rest.stiffening.astype(np.float32),
        manifest=garment.manifest | {"size": size},
        **moved_patches(garment, cleared, body),
    )


def moved_patches(garment: Garment, vertices: np.ndarray, body: BodyModel) -> dict[str, np.ndarray]:
    """Returns the fields of the ``Atlas`` of ``garment`` that change when its vertices move to ``vertices`` [m] (N, 3),
    float32 by name: ``patch_centre``, ``patch_jet``, ``patch_features``, ``chart_uv`` and ``chart_residual``. Patches
    go along with their cloth and keep their frames. Charts that are projections become those of the new places. Charts
    that were laid flat (``drape.garment.unfold``) keep their (u, v), and their in-plane polynomials follow."""
    patch, weight = garment.chart_patch, garment.chart_weight.astype(np.float64)
    rotation, scale = garment.patch_rotation.astype(np.float64), garment.patch_scale.astype(np.float64)
    shares, owner = weight.reshape(-1), patch.reshape(-1)
    way = np.repeat(vertices - garment.vertices, patch.shape[1], axis=0) * shares[:, None]
    moved = np.stack([np.bincount(owner, way[:, k], len(scale)) for k in range(3)], axis=1)
    centre = garment.patch_centre + moved / np.bincount(owner, shares, len(scale))[:, None]
    local = np.einsum("vkba,vkb->vka", rotation[patch], vertices[:, None] - centre[patch])
    sizes = scale[patch][..., None]
    blend, uv, height = ChartBlend(patch, weight), local[..., :2] / sizes, local[..., 2] / scale[patch]
    projected = fit_jets(uv, height, blend, len(scale))
    plane = slice(0, 2 * jets.IN_PLANE_COUNT)
    flat = (garment.patch_jet[:, plane] != projected[:, plane]).any(axis=1)  # those of a projection are the identity
    uv = np.where(flat[patch][..., None], garment.chart_uv.astype(np.float64), uv)
    jet = fit_planes(fit_jets(uv, height, blend, len(scale)), Flattened(blend, uv, flat), local, scale)
    residual = local - sizes * jets.evaluate_jet(jet[patch], uv)
    faces = garment.fine_faces.astype(np.int64)
    features = patch_features(
        centre=centre, rotation=rotation, scale=scale, jet=projected, weights=garment.patch_weights,
        seeds=nearest_vertices(centre, vertices)[1], vertices=vertices, faces=faces, body=body,
        graph=vertex_graph(vertices, faces),
    )  # fmt: skip
    found = {"patch_centre": centre, "patch_jet": jet, "patch_features": features}
    found |= {"chart_uv": uv, "chart_residual": residual}
    return {name: array.astype(np.float32) for name, array in found.items()}


def field_in_space(points: np.ndarray, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Returns the values (N, C) at ``points`` [m] (N, 3) of a smooth field, the spline of |x|, that has ``values`` (A,
    C) at the points ``rows`` (A,)."""
    return _spline(points[rows], values, "linear")(points)


def field_in_panels(uv: np.ndarray, uv_faces: np.ndarray, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Returns the values (T, C) at ``uv`` [m] (T, 2) of a thin-plate spline in each panel that has ``values`` (B, C) at
    the rows ``rows`` (B,) of ``uv``; zeros in a panel that has none of these rows."""
    panel = panels_of(uv, uv_faces)
    field = np.zeros((len(uv), values.shape[1]))
    for number in range(panel.max() + 1):
        mine, given = panel == number, panel[rows] == number
        if given.any():
            field[mine] = _spline(uv[rows[given]], values[given], "thin_plate_spline")(uv[mine])
    return field


def _spline(at: np.ndarray, values: np.ndarray, kernel: str) -> Callable[[np.ndarray], np.ndarray]:
    """The spline of radial basis functions with ``values`` (n, C) at the points ``at`` (n, d)."""
    from scipy.interpolate import RBFInterpolator  # 0.15 s, which a start need not wait for

    return RBFInterpolator(at, values, kernel=kernel, degree=1)


def panels_of(uv: np.ndarray, uv_faces: np.ndarray) -> np.ndarray:
    """Returns for each row of ``uv`` (T, 2) the number (T,) of the connected panel that it belongs to, from 0."""
    return mesh_graphs.connected_components(uv_faces.astype(np.int64), len(uv))


def regraded(edges: np.ndarray, uv: np.ndarray, graded: np.ndarray, uv_faces: np.ndarray) -> np.ndarray:
    """Returns the unstressed edges [m] (F, 2, 2), along (warp, weft) as in ``RestState``, of triangles whose panels
    have changed from ``uv`` to ``graded`` [m] (T, 2). ``edges`` are those before."""
    before, after = (
        np.stack(meshes.corner_edges(np.column_stack([at, np.zeros(len(at))]), uv_faces), axis=1)[..., :2]
        for at in (uv, graded)
    )
    return after @ np.linalg.inv(before) @ edges


def garment_measures(garment: Garment, body: BodyModel) -> dict[str, float]:
    """Returns lengths [m] of ``garment`` on ``body`` in the rest pose. ``chest_m``, ``waist_m`` and ``hip_m``: its
    girths without stress, where it goes around the body. ``length_m``: from its highest to its lowest point.
    ``waist_m`` of a garment that reaches neither chest nor waist is the girth of its upper end."""
    faces, vertices, rest = (
        garment.fine_faces.astype(np.int64),
        garment.vertices.astype(np.float64),
        garment.rest_state(),
    )
    measured = {name: ease.garment_m for name, ease in eases(faces, rest, vertices, body).items()}
    if not measured.keys() & {"chest_m", "waist_m"}:
        top = max(meshes.boundary_loops(faces), key=lambda loop: float(vertices[loop, 1].mean()))
        y, middle = float(vertices[top, 1].min()) - 1e-3, vertices[top][:, [0, 2]].mean(axis=0)
        girth = girth_around(faces, rest, vertices, y=y, middle=middle)
        measured = ({} if girth is None else {"waist_m": girth}) | measured
    return measured | {"length_m": float(np.ptp(vertices[:, 1]))}
