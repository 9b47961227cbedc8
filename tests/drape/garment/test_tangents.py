"""Tangent columns: exact for rigid motion and surfaces in closed form, near the mesh's own normals elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose

from drape.body.assets import load_body
from drape.garment.cache import GARMENTS_DIR, Garment, load_garment
from drape.garment.tangents import tangent_columns
from drape.geometry import jets, meshes
from drape.geometry.rotations import rotvec_to_matrix
from drape.graph.packed import COLUMNS
from tests.fixtures.tiny_model import tube_garment


def coefficients(garment: Garment, jet: np.ndarray, rotation: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Posed jets (K, 3, 18) of patches with frames turned by ``rotation`` and jets changed by ``jet``."""
    local = np.zeros((garment.patch_count, 3, COLUMNS))
    p, q, h = jets.unpack(jet)
    local[:, 0, 3:9], local[:, 1, 3:9], local[:, 2, 3:] = p, q, h
    local[:, :, :3] = np.eye(3)
    scale = garment.patch_scale.astype(np.float64)[:, None, None]
    turned = scale * (rotation @ garment.patch_rotation.astype(np.float64)) @ local
    turned[:, :, 3] += (rotation @ centre[..., None])[..., 0]
    return turned


def summed(garment: Garment, made: np.ndarray, columns: np.ndarray) -> np.ndarray:
    return np.einsum("vkac,vkc...->va...", made[garment.chart_patch[: garment.vertex_count]], columns)


def normals_of(tangents: np.ndarray) -> np.ndarray:
    normal = np.cross(tangents[..., 0], tangents[..., 1])
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def test_a_garment_that_turns_as_a_whole_takes_its_normals_along():
    garment = tube_garment(load_body())
    rotation = rotvec_to_matrix(np.array([0.3, -1.1, 0.4]))
    centre = garment.patch_centre.astype(np.float64)
    made = coefficients(garment, np.zeros((12, 27)), rotation, centre)
    got = normals_of(summed(garment, made, tangent_columns(garment)))
    rest = meshes.vertex_normals(garment.vertices.astype(np.float64), garment.faces)
    assert_allclose(got, rest @ rotation.T, rtol=0, atol=1e-6)


def test_moving_the_garment_leaves_its_normals():
    """The slopes of the weights sum to zero, so that a metre of translation cannot leak in."""
    garment = tube_garment(load_body())
    columns = tangent_columns(garment)
    centre = garment.patch_centre.astype(np.float64)
    near, far = (
        summed(garment, coefficients(garment, np.zeros((12, 27)), np.eye(3), centre + shift), columns)
        for shift in (0.0, 5.0)
    )
    assert_allclose(near, far, rtol=0, atol=1e-9)


def test_one_polynomial_patch_has_its_analytic_normals():
    """A flat sheet in one chart, bent by its jet: tangents are those of the jet, ``drape.geometry.jets``."""
    sheet, scale = one_patch_sheet(), 0.2
    jet = 0.1 * np.random.default_rng(4).normal(size=(1, 27))
    made = coefficients(sheet, jet, np.eye(3), sheet.patch_centre.astype(np.float64))
    columns = tangent_columns(sheet)
    uv = sheet.chart_uv[:, 0].astype(np.float64)
    whole = jet.copy()
    whole[:, 1] += 1.0
    whole[:, jets.IN_PLANE_COUNT + 2] += 1.0
    want = jets.normal(np.broadcast_to(whole, (len(uv), 27)), uv)
    assert_allclose(normals_of(summed(sheet, made, columns)), want, rtol=0, atol=1e-6)
    # Also where the chart's parameters are no projection: a shear, linear, which least squares find exactly.
    shear = np.array([[1.0, 0.3], [0.0, 1.0]])
    sheared = replace(
        sheet,
        chart_uv=(sheet.chart_uv.astype(np.float64) @ shear.T),
        chart_residual=sheet.chart_residual.astype(np.float64)
        + np.concatenate([scale * (uv - uv @ shear.T), np.zeros((len(uv), 1))], axis=1)[:, None],
    )
    position = summed(sheared, made, _columns(sheared))
    tangents = summed(sheared, made, tangent_columns(sheared))
    # By central differences of the surface itself, in the interior where the plane's steps are known.
    assert_allclose(normals_of(tangents)[_inside()], _difference_normals(position)[_inside()], rtol=0, atol=1e-3)


SIDE = 41


def one_patch_sheet() -> Garment:
    """A square of 0.2 m in the plane z = 0 with one chart over all of it."""
    scale = 0.2
    axis = np.linspace(-0.5, 0.5, SIDE)
    u, v = np.meshgrid(axis, axis, indexing="ij")
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    vertices = np.concatenate([scale * uv, np.zeros((len(uv), 1))], axis=1)
    i, j = (index.ravel() for index in np.meshgrid(np.arange(SIDE - 1), np.arange(SIDE - 1), indexing="ij"))
    a, b, c, d = i * SIDE + j, (i + 1) * SIDE + j, (i + 1) * SIDE + j + 1, i * SIDE + j + 1
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    tube = tube_garment(load_body())
    jet = np.zeros((1, 27))
    jet[0, 1] = jet[0, jets.IN_PLANE_COUNT + 2] = 1.0
    zeros = np.zeros((len(uv), 4))
    return replace(
        tube,
        vertex_count=len(uv),
        vertices=vertices,
        faces=faces,
        fine_faces=faces,
        patch_rotation=np.eye(3)[None],
        patch_centre=np.zeros((1, 3)),
        patch_scale=np.array([scale]),
        patch_jet=jet,
        patch_weights=tube.patch_weights[:1],
        chart_patch=zeros.astype(np.int64),
        chart_uv=np.repeat(uv[:, None], 4, axis=1),
        chart_weight=zeros + np.array([1.0, 0.0, 0.0, 0.0]),
        chart_residual=np.zeros((len(uv), 4, 3)),
    )


def _columns(garment: Garment) -> np.ndarray:
    scale = garment.patch_scale[garment.chart_patch][..., None]
    basis = jets.basis(garment.chart_uv.astype(np.float64), jets.HEIGHT_ORDER)
    return garment.chart_weight[..., None] * np.concatenate([garment.chart_local() / scale, basis], axis=-1)


def _difference_normals(position: np.ndarray) -> np.ndarray:
    grid = position.reshape(SIDE, SIDE, 3)
    along = np.stack([np.gradient(grid, axis=0), np.gradient(grid, axis=1)], axis=-1)
    return normals_of(along.reshape(-1, 3, 2))


def _inside() -> np.ndarray:
    inside = np.zeros((SIDE, SIDE), dtype=bool)
    inside[1:-1, 1:-1] = True
    return inside.ravel()


def test_shipped_garments_keep_their_rest_normals_and_follow_bending():
    for path in sorted(GARMENTS_DIR.glob("s*.npz")):
        garment = load_garment(path)
        columns = tangent_columns(garment)
        centre = garment.patch_centre.astype(np.float64)
        rest = meshes.vertex_normals(garment.vertices[: garment.vertex_count].astype(np.float64), garment.faces)
        made = coefficients(garment, np.zeros((garment.patch_count, 27)), np.eye(3), centre)
        assert_allclose(normals_of(summed(garment, made, columns)), rest, rtol=0, atol=1e-5)
        # Neighbouring patches turned differently disagree: there the slopes of the weights count.
        turn = rotvec_to_matrix(0.1 * np.random.default_rng(0).normal(size=(garment.patch_count, 3)))
        made = coefficients(garment, np.zeros((garment.patch_count, 27)), turn, centre)
        made[:, :, 3] += centre - (turn @ centre[..., None])[..., 0]  # about their own centres
        scale = garment.patch_scale[garment.chart_patch][..., None]
        basis = jets.basis(garment.chart_uv.astype(np.float64), jets.HEIGHT_ORDER)
        place = np.concatenate([garment.chart_local() / scale, basis], axis=-1) * garment.chart_weight[..., None]
        position = summed(garment, made, place[: garment.vertex_count])
        of_mesh = meshes.vertex_normals(position, garment.faces)
        got = normals_of(summed(garment, made, columns))
        angle = np.degrees(np.arccos(np.clip(np.sum(got * of_mesh, axis=1), -1.0, 1.0)))
        turned = np.degrees(np.arccos(np.clip(np.sum(rest * of_mesh, axis=1), -1.0, 1.0)))
        assert angle.mean() < 0.25 * turned.mean()
