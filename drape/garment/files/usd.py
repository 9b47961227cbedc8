"""Reads the meshes of a USD file (``.usd``, ``.usda``, ``.usdc``, ``.usdz``) by the package usd-core.

A file that names others is refused: they would be this machine's. Only what is drawn counts, not hidden prims, guides
and proxies. Lengths are in the unit that the file states, if it states one, and its up axis always holds.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np

from drape.garment.files.archive import files_beside, zip_members
from drape.garment.files.mesh import (
    Beside,
    GarmentMesh,
    MeshPart,
    check_count,
    fans,
    in_stated_unit,
    join_parts,
    mesh_fault,
)
from drape.garment.files.usd_looks import coordinates_of, usd_looks

MOST_PRIMS = 100_000
SHOWN = ("default", "render")  # the purposes of prims that are drawn


class _Part(NamedTuple):
    """A ``mesh``, the ``materials`` that are bound to it, None for the usual one, and which of them each triangle has
    (F,)."""

    mesh: MeshPart
    materials: tuple[Any, ...]
    face_material: np.ndarray


def read_usd(payload: bytes, *, name: str, vertex_limit: int, beside: Beside = lambda wanted: None) -> GarmentMesh:
    """Returns the drawn meshes of a USD file as one, in world axes turned to y up, in metres if the file states its
    unit. Vertices keep the file's order. Pictures come from the usdz archive or by ``beside``. Raises ``MeshError``."""
    try:
        sdf, tf, usd = (import_module(f"pxr.{one}") for one in ("Sdf", "Tf", "Usd"))
    except ModuleNotFoundError as error:
        cure = "Install it (pip install usd-core), or export the mesh as OBJ or GLB."
        raise mesh_fault(name, "the package usd-core, which reads USD", "none", cure) from error
    suffix = ".usdz" if payload[:2] == b"PK" else ".usd"
    if suffix == ".usdz":
        beside = files_beside(zip_members(payload, name), PurePosixPath())
    with tempfile.TemporaryDirectory(prefix="usd-") as folder:
        path = Path(folder) / f"garment{suffix}"
        path.write_bytes(payload)
        try:
            layer = sdf.Layer.FindOrOpen(str(path))
            others = layer.GetCompositionAssetDependencies() if layer else []
            if others:
                raise mesh_fault(name, "one file that holds everything", f"a reference to {others[0]}", "Flatten it.")
            stage = usd.Stage.Open(layer, usd.Stage.LoadNone) if layer else None
            if stage is None:
                raise mesh_fault(name, "a readable USD file", "a damaged one")
            return _joined(list(_parts(stage, name, vertex_limit)), stage, name, beside)
        except tf.ErrorException as error:  # its text would name files of this machine
            raise mesh_fault(name, "a readable USD file", "a damaged one") from error


def _parts(stage: Any, name: str, vertex_limit: int) -> Iterator[_Part]:
    """The drawn meshes of ``stage``, whose declared counts are checked before anything is made of them."""
    usd, geometry = (import_module(f"pxr.{one}") for one in ("Usd", "UsdGeom"))
    time = usd.TimeCode.EarliestTime()
    placed, total = geometry.XformCache(time), 0
    for count, prim in enumerate(stage.Traverse(usd.TraverseInstanceProxies())):
        if count >= MOST_PRIMS:
            raise mesh_fault(name, f"at most {MOST_PRIMS:,} prims", "more", "Export the garment alone.")
        if not prim.IsA(geometry.Mesh):
            continue
        mesh = geometry.Mesh(prim)
        if mesh.ComputeVisibility(time) == geometry.Tokens.invisible or mesh.ComputePurpose() not in SHOWN:
            continue
        points = _numbers(mesh.GetPointsAttr().Get(time)).reshape(-1, 3)
        sides = _numbers(mesh.GetFaceVertexCountsAttr().Get(time), np.int64)
        corners = _numbers(mesh.GetFaceVertexIndicesAttr().Get(time), np.int64)
        total += len(points)
        check_count(name, max(total, len(corners) // 8), vertex_limit)
        if (sides < 3).any() or sides.sum() != len(corners):
            got = f"{len(sides)} faces for {len(corners)} corners in {prim.GetPath()}"
            raise mesh_fault(name, "faces of three and more corners, as many as are listed", got)
        if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
            raise mesh_fault(name, f"corners below {len(points)}", f"{corners.min()} to {corners.max()}")
        matrix = np.array(placed.GetLocalToWorldTransform(prim))
        fan = fans(sides)
        left = mesh.GetOrientationAttr().Get(time) == geometry.Tokens.leftHanded
        if left != (np.linalg.det(matrix[:3, :3]) < 0.0):
            fan = fan[:, ::-1]
        materials, polygon_material = _materials(prim, time, len(sides))
        uv = _uv(geometry.PrimvarsAPI(prim), time, corners, len(points), fan, coordinates_of(materials))
        placed_points = points @ matrix[:3, :3] + matrix[3, :3]
        face_material = np.repeat(polygon_material, sides - 2)
        part = MeshPart(placed_points, corners[fan], uv, int((sides > 3).sum()))
        yield _Part(part, materials, face_material)


def _numbers(value: Any, dtype: type = np.float64) -> np.ndarray:
    """An array of ``value``; none in it where a file says there what is no array of numbers."""
    try:
        return np.asarray([] if value is None else value, dtype=dtype)
    except (TypeError, ValueError):
        return np.zeros(0, dtype=dtype)


def _materials(prim: Any, time: Any, count: int) -> tuple[tuple[Any, ...], np.ndarray]:
    """The materials that are bound to ``prim`` and to subsets of its faces, and which of them each polygon has."""
    api = import_module("pxr.UsdShade").MaterialBindingAPI
    own = api(prim).ComputeBoundMaterial()[0]
    materials, number = [own.GetPrim() if own else None], np.zeros(count, dtype=np.int64)
    for subset in api(prim).GetMaterialBindSubsets():
        bound = api(subset.GetPrim()).ComputeBoundMaterial()[0]
        rows = _numbers(subset.GetIndicesAttr().Get(time), np.int64)
        number[rows[(rows >= 0) & (rows < count)]] = len(materials)
        materials.append(bound.GetPrim() if bound else None)
    used = np.unique(number)
    return tuple(materials[i] for i in used), np.searchsorted(used, number)


def _uv(
    primvars: Any, time: Any, corners: np.ndarray, point_count: int, fan: np.ndarray, wanted: str
) -> np.ndarray | None:
    """Texture coordinates (3 F, 2) of the triangles' corners: the primvar ``wanted``, else the first of their kind,
    that is as long as it must be."""
    for one in sorted(primvars.GetPrimvars(), key=lambda one: one.GetPrimvarName() != wanted):
        if "texCoord2" not in str(one.GetTypeName()) and one.GetPrimvarName() not in ("st", "UVMap", "map1", wanted):
            continue
        values = _numbers(one.ComputeFlattened(time))
        by_corner = values if len(values) == len(corners) else values[corners] if len(values) == point_count else None
        if by_corner is not None and by_corner.ndim == 2 and by_corner.shape[1] == 2:
            return by_corner[fan.reshape(-1)]
    return None


def _joined(parts: list[_Part], stage: Any, name: str, beside: Beside) -> GarmentMesh:
    """The mesh of all ``parts`` of ``stage``, y up, with the looks of their materials."""
    mesh, geometry = join_parts(name, [part.mesh for part in parts]), import_module("pxr.UsdGeom")
    stated_m = geometry.GetStageMetersPerUnit(stage) if geometry.StageHasAuthoredMetersPerUnit(stage) else 1.0
    upright = geometry.GetStageUpAxis(stage) == geometry.Tokens.y
    points, unit_note = in_stated_unit(stated_m * mesh.vertices, stated_m)
    if not upright:
        points = np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)
    materials = list(dict.fromkeys(one for part in parts for one in part.materials))
    names = tuple("default" if one is None else one.GetName() for one in materials)
    rows = [np.array([materials.index(one) for one in part.materials]) for part in parts]
    material = np.concatenate([row[part.face_material] for row, part in zip(rows, parts, strict=True)])
    looks, notes = usd_looks(materials, beside)
    mesh = replace(mesh, vertices=points, material_names=names, face_material=material.astype(np.int64), looks=looks)
    mesh = mesh.noted(*notes)
    if stated_m != 1.0:
        mesh = mesh.noted(unit_note)
    return mesh if upright else mesh.noted("turned from z up to y up")
