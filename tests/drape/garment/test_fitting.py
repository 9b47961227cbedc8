"""Laws of the fit: reconstruction, closed forms, convergence with the patch count, determinism, rigid motion."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.garment import charts, fitting
from drape.garment.fitting import RestGarment, fit_error, fit_garment, fit_jets, patch_fields
from drape.garment.partition import patch_count_for
from drape.geometry import jets, meshes
from tests.drape.cloth.cloth_shapes import grid, random_rotation, tube
from tests.drape.garment.rest_garments import PATCH_COUNT, barrel, barrel_garment, barrel_mesh
from tests.fixtures.garments import default_body, shipped

EXACT = 1e-12
MICROMETRE = 1e-6


def even_height(x, y):
    """A quartic without odd terms: half a turn about z maps its graph to itself, so the mean normal is z."""
    return 1.5 * x * x - 0.8 * x * y + 2.0 * y * y + 20.0 * x**4 - 10.0 * x * x * y * y + 15.0 * x * y**3


def graph_garment() -> RestGarment:
    vertices, faces = grid(30, 24, cell_m=0.01)
    vertices = vertices - vertices.mean(axis=0)
    vertices[:, 2] = even_height(vertices[:, 0], vertices[:, 1])
    return fitting.rest_garment(vertices + np.array([0.0, 0.3, 0.4]), faces, default_body())


@pytest.fixture
def samples(rng):
    """Parameters, exact heights and blend of 900 samples of three random quartic patches, and their coefficients."""
    uv, height = rng.uniform(-1.0, 1.0, (900, 4, 2)), rng.normal(size=(3, jets.HEIGHT_COUNT))
    patch = np.tile(np.array([0, 1, 2, 0], dtype=np.int32), (900, 1))
    weight = np.concatenate([rng.dirichlet(np.ones(3), 900), np.zeros((900, 1))], axis=1)
    values = (jets.basis(uv, jets.HEIGHT_ORDER) * height[patch]).sum(axis=-1)
    values[:, 3] = 1e3  # a slot without weight must not be heard
    return uv, values, charts.ChartBlend(patch, weight), height


def test_exact_quartics_are_found_again(samples):
    uv, values, blend, height = samples
    jet = fit_jets(uv, values, blend, 3)
    p, q, h = jets.unpack(jet)
    assert_allclose(h, height, rtol=0.0, atol=1e-3)
    flat = np.zeros((3, jets.IN_PLANE_COUNT))
    assert_array_equal(p, flat + np.eye(jets.IN_PLANE_COUNT)[1])
    assert_array_equal(q, flat + np.eye(jets.IN_PLANE_COUNT)[2])


def test_error_of_the_fit_is_of_the_order_of_the_ridge(samples, monkeypatch):
    uv, values, blend, height = samples
    errors = []
    for ridge in (1e-3, 1e-4, 1e-5):
        monkeypatch.setattr(charts, "RIDGE", ridge)
        errors.append(np.abs(jets.unpack(fit_jets(uv, values, blend, 3))[2] - height).max())
    assert_allclose(np.log10(np.array(errors[:-1]) / errors[1:]), 1.0, rtol=0.0, atol=0.05)


def test_patch_without_samples_is_flat():
    blend = charts.ChartBlend(np.zeros((5, 4), dtype=np.int32), np.tile([1.0, 0.0, 0.0, 0.0], (5, 1)))
    jet = fit_jets(np.zeros((5, 4, 2)), np.full((5, 4), 0.3), blend, 2)
    assert_array_equal(jets.unpack(jet)[2][1], np.zeros(jets.HEIGHT_COUNT))


def test_quartic_height_field_is_one_patch_to_the_ridge(monkeypatch):
    rest = graph_garment()
    fields = patch_fields(rest, count=1)
    assert_allclose(fields["patch_rotation"][0][:, 2], [0.0, 0.0, 1.0], rtol=0.0, atol=1e-6)
    figures = fit_error(rest, fields)
    assert figures["point_rmse_m"] < 3e-5  # of 80 mm
    # Against the vertex normals of a mesh of 1 cm edges, which are off by that much themselves.
    assert figures["normal_error_deg"] < 0.3
    assert figures["folded_chart_entries"] == 0
    monkeypatch.setattr(charts, "RIDGE", 1e-12)
    assert fit_error(rest, patch_fields(rest, count=1))["point_rmse_m"] < 1e-7


def test_error_shrinks_with_the_patch_count():
    rest = fitting.rest_garment(shipped("tank").vertices, shipped("tank").fine_faces, default_body())
    errors = [fit_error(rest, patch_fields(rest, count=count))["point_rmse_m"] for count in (20, 40, 80)]
    assert errors[1] < 0.7 * errors[0]  # 0.65 and 0.58: folds are finer than 20 patches see
    assert errors[2] < 0.7 * errors[1]


def test_every_chart_of_a_vertex_alone_gives_it_back():
    garment = barrel_garment()
    rotation, centre = garment.patch_rotation[garment.chart_patch], garment.patch_centre[garment.chart_patch]
    placed = np.einsum("vkab,vkb->vka", rotation.astype(float), garment.chart_local()) + centre
    error = np.abs(placed - garment.vertices[:, None])[garment.chart_weight > 0.0]
    assert error.max() < MICROMETRE


def test_residual_of_the_in_plane_part_is_zero():
    # The rest jet's p and q are the parameters themselves; only the height leaves something over.
    assert_allclose(barrel_garment().chart_residual[..., :2], 0.0, rtol=0.0, atol=1e-8)


def test_fields_are_the_same_for_the_same_seed_and_differ_for_another():
    first, again, other = (patch_fields(barrel(), count=PATCH_COUNT, seed=seed) for seed in (7, 7, 8))
    for key, value in first.items():
        assert_array_equal(value, again[key])
    assert np.abs(first["patch_centre"] - other["patch_centre"]).max() > 1e-3


def test_indices_are_int32_and_numbers_float32():
    for key, value in patch_fields(barrel(), count=PATCH_COUNT).items():
        assert value.dtype == (np.int32 if key in ("chart_patch", "patch_neighbours") else np.float32)


def test_patches_hang_as_the_mean_of_their_vertices():
    fields = patch_fields(barrel(), count=PATCH_COUNT)
    assert_allclose(fields["patch_weights"].sum(axis=1), 1.0, rtol=0.0, atol=1e-6)
    binding, one = barrel().binding, patch_fields(barrel(), count=1)
    area = barrel().areas / barrel().areas.sum()
    assert_allclose(one["patch_weights"][0], area @ binding.weights, rtol=0.0, atol=1e-6)
    assert_allclose(one["patch_shapedirs"][0], np.einsum("v,vab->ab", area, binding.shapedirs), rtol=0.0, atol=1e-6)


def test_neighbours_are_pairs_in_order_and_link_the_whole_piece():
    pairs = patch_fields(barrel(), count=PATCH_COUNT)["patch_neighbours"]
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    reached = {0}
    for _ in range(PATCH_COUNT):
        reached |= {int(b) for pair in pairs.tolist() for a, b in (pair, pair[::-1]) if a in reached}
    assert reached == set(range(PATCH_COUNT))


def test_patch_count_is_that_of_the_area_unless_given_and_never_above_the_vertices():
    vertices, faces = tube(20, 8, radius_m=0.25, height_m=0.5)
    rest = fitting.rest_garment(vertices, faces, default_body())
    assert len(patch_fields(rest)["patch_centre"]) == patch_count_for(rest.areas.sum()) == 100
    small = fitting.rest_garment(*grid(3, 3), default_body())
    assert len(patch_fields(small)["patch_centre"]) == 16


def test_patches_move_with_garment_and_body(rng):
    """Turning garment, body and weights together turns centres and frames and leaves everything in them."""
    # Creased, since on an even tube many vertices lie equally far from two patches and rounding decides.
    creases = 0.002 * rng.normal(size=barrel().vertices.shape)
    rest = RestGarment(barrel().vertices + creases, barrel().faces, barrel().binding, default_body())
    turn, shift = random_rotation(rng), rng.normal(size=3)
    body = dataclasses.replace(
        rest.body,
        v_template=rest.body.v_template @ turn.T + shift,
        shapedirs=np.einsum("ab,vbs->vas", turn, rest.body.shapedirs),
    )
    binding = dataclasses.replace(rest.binding, shapedirs=np.einsum("ab,vbs->vas", turn, rest.binding.shapedirs))
    moved = RestGarment(rest.vertices @ turn.T + shift, rest.faces, binding, body)
    want, got = (patch_fields(r, count=PATCH_COUNT) for r in (rest, moved))
    for key in ("chart_patch", "patch_neighbours"):
        assert_array_equal(got[key], want[key])
    for key in ("chart_uv", "chart_weight", "chart_residual", "patch_scale", "patch_weights", "patch_jet"):
        assert_allclose(got[key], want[key], rtol=0.0, atol=1e-5)
    assert_allclose(got["patch_rotation"], turn @ want["patch_rotation"], rtol=0.0, atol=1e-5)
    assert_allclose(got["patch_centre"], want["patch_centre"] @ turn.T + shift, rtol=0.0, atol=1e-6)
    assert_allclose(got["patch_shapedirs"], turn @ want["patch_shapedirs"], rtol=0.0, atol=1e-6)


def test_rest_geometry_is_that_of_the_mesh():
    rest = barrel()
    assert_allclose(rest.areas, meshes.vertex_areas(rest.vertices, rest.faces), rtol=1e-12, atol=0.0)
    radial = rest.vertices * [1.0, 0.0, 1.0] / 0.25
    inner = (rest.vertices[:, 1] > rest.vertices[:, 1].min()) & (rest.vertices[:, 1] < rest.vertices[:, 1].max())
    assert_allclose(rest.normals[inner], radial[inner], rtol=0.0, atol=1e-9)
    lone = fitting.rest_garment(np.concatenate([rest.vertices, [[0.0, 0.0, 1.0]]]), rest.faces, default_body())
    assert lone.areas[-1] > 0.0
    assert_array_equal(lone.normals[-1], np.zeros(3))


def test_garment_keeps_the_mesh_it_was_given():
    given, garment = barrel_mesh(), barrel_garment()
    assert garment.vertex_count == len(given.vertices) < len(garment.vertices)
    assert_allclose(garment.vertices, barrel().vertices, rtol=0.0, atol=1e-7)
    wanted = {"faces": given.faces, "fine_faces": barrel().faces, "face_material": given.face_material}
    for key, want in wanted.items():
        assert_array_equal(getattr(garment, key), want)
        assert getattr(garment, key).dtype == np.int32
    assert (garment.uv.shape, garment.uv_faces.shape) == ((0, 2), (0, 3))
    assert garment.material_names == ("cotton", "hem")
    assert (garment.name, garment.digest, garment.body_digest) == ("barrel", "d" * 64, default_body().digest)
    # Found again from float32: shares about a thousandth may be left out in one and not in the other.
    assert_allclose(garment.skin_weights(default_body()), barrel().binding.weights, rtol=0.0, atol=1e-3)


def test_texture_coordinates_are_kept():
    uv, uv_faces = np.array([[0.0, 1.0], [0.5, 0.5], [1.0, 0.0]]), np.array([[0, 1, 2]])
    given, rest = replace(barrel_mesh(), uv=uv, uv_faces=uv_faces), barrel()
    garment = fit_garment(given, rest.vertices, rest.faces, default_body(), digest="d" * 64, manifest={}, count=2)
    assert_array_equal(garment.uv, uv)
    assert_array_equal(garment.uv_faces, uv_faces)


def test_manifest_says_where_it_came_from_and_how_well_it_fits():
    garment = barrel_garment()
    assert garment.manifest["source"] == "a tube"
    figures = garment.manifest["fit"]
    assert figures["patch_count"] == garment.patch_count == PATCH_COUNT
    assert_allclose(figures["area_m2"], 2.0 * np.pi * 0.25 * 0.5, rtol=0.01, atol=0.0)
    again = fit_error(barrel(), patch_fields(barrel(), count=PATCH_COUNT))
    assert figures == again | {"patch_count": PATCH_COUNT, "area_m2": figures["area_m2"]}
    assert 0.0 < figures["point_rmse_m"] < figures["point_max_m"] < 0.01
    assert 0.0 < figures["normal_error_deg"] < 5.0


def test_folded_charts_are_counted():
    rest, fields = barrel(), patch_fields(barrel(), count=PATCH_COUNT)
    jet = fields["patch_jet"].copy()
    jet[:, 1] *= -1.0  # u runs backwards: the normal points inwards
    used = int((fields["chart_weight"] > 0.0).sum())
    assert fit_error(rest, {**fields, "patch_jet": jet})["folded_chart_entries"] == used
