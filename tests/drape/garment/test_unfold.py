"""Fold-over is seen where it is, and gone after the charts are laid flat."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.garment import charts, fitting
from drape.garment.fitting import fit_error, patch_fields
from drape.garment.unfold import (
    FADE,
    Flattened,
    _chart,
    chart_triangles,
    fit_planes,
    folded_charts,
    folded_triangles,
    without_folds,
)
from drape.geometry import jets
from drape.geometry.meshes import signed_areas
from tests.drape.cloth.cloth_shapes import grid, tube
from tests.drape.garment.rest_garments import barrel
from tests.drape.geometry.geometry_shapes import icosphere
from tests.fixtures.garments import default_body, shipped

PLACE = np.array([0.0, 0.3, 0.4])  # before the chest of the body


def hem(rows: int = 24, columns: int = 20, *, cell_m: float = 0.01) -> fitting.RestGarment:
    """Cloth that goes up, over a bend of 8 mm radius, and down again: no plane sees it whole."""
    vertices, faces = grid(columns, rows, cell_m=cell_m)
    along = vertices[:, 1] - vertices[:, 1].mean()
    radius = 0.008
    angle = np.clip(along / radius, -0.6 * np.pi, 0.6 * np.pi)
    rest = along - radius * angle
    y = radius * np.cos(angle) - np.sign(angle) * rest * np.sin(angle)
    z = radius * np.sin(angle) + rest * np.cos(angle)
    placed = np.stack([vertices[:, 0], 0.3 + y, 0.4 + z], axis=1)
    return fitting.rest_garment(placed, faces, default_body())


def fields_blend(fields: dict[str, np.ndarray]) -> charts.ChartBlend:
    return charts.ChartBlend(fields["chart_patch"], fields["chart_weight"])


def test_a_flat_sheet_has_every_face_in_every_chart_and_no_fold():
    vertices, faces = grid(12, 10, cell_m=0.01)
    rest = fitting.rest_garment(vertices + PLACE, faces, default_body())
    fields = patch_fields(rest, count=1)
    blend = fields_blend(fields)
    owner, corners = chart_triangles(blend, faces)
    assert len(owner) == len(faces) and (owner == 0).all()
    assert (signed_areas(fields["chart_uv"].reshape(-1, 2), corners) > 0).all()
    assert_array_equal(folded_triangles(blend, fields["chart_uv"], faces), [0])


def test_a_mirrored_chart_is_folded_everywhere():
    fields = patch_fields(barrel(), count=12)
    blend = fields_blend(fields)
    owner, _ = chart_triangles(blend, barrel().faces)
    before = folded_triangles(blend, fields["chart_uv"], barrel().faces)
    mirrored = fields["chart_uv"] * np.array([-1.0, 1.0], dtype=np.float32)
    after = folded_triangles(blend, mirrored, barrel().faces)
    assert_array_equal(before + after, np.bincount(owner, minlength=len(before)))


@pytest.mark.parametrize("count", [1, 4])
def test_cloth_bent_past_its_plane_folds_when_projected_and_not_when_unfolded(count):
    rest = hem()
    projected, flat = patch_fields(rest, count=count), patch_fields(rest, count=count, unfold=True)
    assert folded_triangles(fields_blend(projected), projected["chart_uv"], rest.faces).sum() > 0
    assert folded_triangles(fields_blend(flat), flat["chart_uv"], rest.faces).sum() == 0


def test_unfolded_charts_give_back_every_vertex():
    rest = hem()
    fields = patch_fields(rest, count=4, unfold=True)
    patch, weight = fields["chart_patch"], fields["chart_weight"].astype(np.float64)
    assert_allclose(weight.sum(axis=1), 1.0, rtol=0, atol=1e-6)
    scale = fields["patch_scale"].astype(np.float64)
    local = scale[patch][..., None] * jets.evaluate_jet(
        fields["patch_jet"].astype(np.float64)[patch], fields["chart_uv"].astype(np.float64)
    )
    placed = np.einsum("vkab,vkb->vka", fields["patch_rotation"][patch], local + fields["chart_residual"])
    blended = np.einsum("vk,vka->va", weight, placed + fields["patch_centre"][patch])
    assert_allclose(blended, rest.vertices, rtol=0, atol=1e-6)


def test_what_the_network_reads_does_not_depend_on_unfolding():
    rest = hem()
    projected, flat = patch_fields(rest, count=4), patch_fields(rest, count=4, unfold=True)
    changed = {key for key in projected if not np.array_equal(projected[key], flat[key])}
    assert changed | {"chart_weight"} == {"patch_jet", "chart_uv", "chart_weight", "chart_residual"}
    in_plane = flat["patch_jet"][:, : 2 * jets.IN_PLANE_COUNT]
    assert not np.allclose(in_plane, projected["patch_jet"][:, : 2 * jets.IN_PLANE_COUNT], atol=1e-3)


def test_in_plane_jets_of_an_unfolded_chart_follow_a_quadratic_exactly(rng):
    uv = rng.uniform(-1, 1, size=(60, 4, 2))
    weight = np.zeros((60, 4))
    weight[:, 0] = 1.0
    wanted = np.zeros((1, jets.JET_COUNT))
    wanted[0, : 2 * jets.IN_PLANE_COUNT] = rng.normal(size=2 * jets.IN_PLANE_COUNT)
    local = 0.05 * jets.evaluate_jet(np.broadcast_to(wanted, (60, 4, jets.JET_COUNT)), uv)
    start = np.zeros((1, jets.JET_COUNT))
    start[0, 1] = start[0, jets.IN_PLANE_COUNT + 2] = 1.0
    blend = charts.ChartBlend(np.zeros((60, 4), dtype=np.int32), weight)
    found = fit_planes(start, Flattened(blend, uv, np.array([True])), local, np.array([0.05]))
    assert_allclose(found[:, : 2 * jets.IN_PLANE_COUNT], wanted[:, : 2 * jets.IN_PLANE_COUNT], rtol=0, atol=1e-4)
    untouched = fit_planes(start, Flattened(blend, uv, np.array([False])), local, np.array([0.05]))
    assert_array_equal(untouched, start)


def test_charts_without_a_fold_are_left_alone():
    rest = barrel()
    plain, asked = patch_fields(rest, count=40), patch_fields(rest, count=40, unfold=True)
    folded = folded_triangles(fields_blend(plain), plain["chart_uv"], rest.faces) > 0
    same = ~folded[plain["chart_patch"]]
    assert same.any()
    assert_array_equal(asked["chart_uv"][same], plain["chart_uv"][same])


def sleeve(radius_m: float = 0.03) -> fitting.RestGarment:
    """A tube so narrow that every chart runs all round it."""
    vertices, faces = tube(32, 24, radius_m=radius_m, height_m=0.15)
    return fitting.rest_garment(vertices + PLACE, faces, default_body())


def test_charts_that_run_round_a_limb_are_cut_open():
    rest = sleeve()
    plain, asked = patch_fields(rest, count=10), patch_fields(rest, count=10, unfold=True)
    assert folded_triangles(fields_blend(plain), plain["chart_uv"], rest.faces).sum() > 0
    assert folded_triangles(fields_blend(asked), asked["chart_uv"], rest.faces).sum() == 0
    assert_allclose(asked["chart_weight"].sum(axis=1), 1.0, rtol=0, atol=1e-6)
    before, after = plain["chart_weight"] > 0, asked["chart_weight"] > 0
    assert (after <= before).all()
    assert 0.8 * before.sum() < after.sum() < before.sum()  # cuts, not cropping


def test_a_chart_fades_towards_the_vertices_that_leave_it():
    points, faces = tube(32, 12, radius_m=0.5, height_m=1.0)
    kept, placed, fade = _chart(points, faces, np.exp(2.0 * points[:, 2]))
    assert (signed_areas(placed, np.searchsorted(kept, faces[np.isin(faces, kept).all(axis=1)])) > 0).all()
    left = np.setdiff1d(np.arange(len(points)), kept)
    assert len(left) == 13 and (fade[left] == 0.0).all()  # one vertex per ring
    along = np.sqrt(np.sum((points[:, None] - points[None, left]) ** 2, axis=-1)).min(axis=1)
    assert (fade[along > np.pi * 0.5 * FADE] == 1.0).all()  # a chord is no shorter than 2/pi of its arc
    step = np.minimum(along / FADE, 1.0)
    beside = (along > 0) & (along < 0.15)
    assert beside.any() and (fade[beside] > 0).all()
    assert_allclose(fade[beside], (step**2 * (3.0 - 2.0 * step))[beside], rtol=0, atol=0.05)


def test_a_closed_chart_is_made_smaller():
    points, faces = icosphere(3, radius_m=0.05)
    blend = charts.ChartBlend(np.tile(np.arange(4, dtype=np.int32), (len(points), 1)), np.full((len(points), 4), 0.25))
    blend.weight[:, 0] += 1e-3 * points[:, 2]  # the first chart is heaviest where z is largest
    local = np.repeat(points[:, None], 4, axis=1)
    found = without_folds(blend, local, np.full(4, 0.05), faces)
    assert found.unfolded.all()
    assert 0 < (found.blend.weight[:, 0] > 0).sum() < len(points)
    assert found.blend.weight[np.argmax(points[:, 2]), 0] > 0


def test_a_lone_chart_round_a_limb_is_counted_as_what_it_is():
    rest = sleeve()
    fields = patch_fields(rest, count=1, unfold=True)
    assert folded_triangles(fields_blend(fields), fields["chart_uv"], rest.faces).sum() > 0
    assert_allclose(fields["chart_weight"].sum(axis=1), 1.0, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", [pytest.param("trousers", marks=pytest.mark.long), "shorts"])
def test_every_chart_of_a_garment_is_a_bijection_after_the_fit(name):
    garment = shipped(name)
    rest = fitting.rest_garment(garment.vertices, garment.fine_faces, default_body())
    before, after = patch_fields(rest), patch_fields(rest, unfold=True)
    first, second = fit_error(rest, before), fit_error(rest, after)
    assert first["folded_charts"] > 0 and first["folded_chart_triangles"] > 0
    assert second["folded_charts"] == second["folded_chart_triangles"] == 0
    assert second["point_rmse_m"] < first["point_rmse_m"]
    blend = fields_blend(before)
    folded = folded_charts(blend, before["chart_uv"], rest.faces)
    assert (folded >= (folded_triangles(blend, before["chart_uv"], rest.faces) > 0)).all()
    assert folded.sum() == first["folded_charts"]
