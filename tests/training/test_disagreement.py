"""Disagreement of charts, on garments whose charts are known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.errors import InputError
from drape.garment.cache import Garment
from drape.geometry import jets
from drape.geometry.rotations import rotvec_to_matrix
from tests.drape.cloth.cloth_shapes import grid
from tests.fixtures import garments
from tests.fixtures.laws import each, made
from training.disagreement import LEAST_WEIGHT, chart_normals, chart_positions, disagreement

PATCHES = 5


def flat_sheet() -> Garment:
    """A flat sheet under five charts: tilted frames of any scale, and (u, v) any linear map of the plane."""
    rng = np.random.default_rng(5)
    rest, faces = grid(6, 5, cell_m=0.02)
    rotation = rotvec_to_matrix(rng.uniform(-0.4, 0.4, size=(PATCHES, 3)))
    centre, scale = rng.uniform(0.0, 0.1, size=(PATCHES, 3)), rng.uniform(0.05, 0.2, size=PATCHES)
    patch = np.argsort(rng.random((len(rest), PATCHES)), axis=1)[:, :4]
    local = np.einsum("vkba,vkb->vka", rotation[patch], rest[:, None] - centre[patch])
    shear = np.eye(2) + rng.uniform(-0.3, 0.3, size=(PATCHES, 2, 2))
    uv = np.einsum("vkij,vkj->vki", shear[patch], local[..., :2]) / scale[patch][..., None]
    jet = 0.1 * rng.normal(size=(PATCHES, jets.JET_COUNT))
    weight = rng.uniform(0.1, 1.0, size=patch.shape)
    return replace(
        garments.tube(),
        vertices=rest,
        fine_faces=faces,
        patch_rotation=rotation,
        patch_centre=centre,
        patch_scale=scale,
        patch_jet=jet,
        chart_patch=patch,
        chart_uv=uv,
        chart_weight=weight / weight.sum(axis=1, keepdims=True),
        chart_residual=local - scale[patch][..., None] * jets.evaluate_jet(jet[patch], uv),
    )


def at_rest(garment: Garment, frames: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Arguments of ``disagreement`` that move nothing."""
    count = garment.patch_count
    return (
        np.zeros((frames, count, jets.JET_COUNT)),
        np.broadcast_to(garment.patch_rotation, (frames, count, 3, 3)).copy(),
        np.broadcast_to(garment.patch_centre, (frames, count, 3)).copy(),
    )


SHEET = made(sheet=flat_sheet)


@each(garment=made(tube=garments.tube) | SHEET)
def test_charts_at_rest_agree_exactly(garment):
    found = disagreement(garment, *at_rest(garment, frames=2))
    assert_allclose(found.gap_m, 0.0, rtol=0.0, atol=1e-8)
    assert_allclose(found.normal_rad, 0.0, rtol=0.0, atol=1e-6)
    overlap = (garment.chart_weight > LEAST_WEIGHT).sum(axis=1) > 1
    assert found.normal_rad.shape == (2, overlap.sum())
    assert found.gap_m.shape == (2, (garment.chart_weight > LEAST_WEIGHT)[overlap].sum())


def test_a_shifted_patch_stands_off_by_the_weight_of_the_others(tube):
    jet, rotation, centre = at_rest(tube, frames=2)
    moved, shift = 4, np.array([0.01, -0.02, 0.005])
    # Frame 0 by the constant terms of the jet, frame 1 by the frame.
    jet[0, moved, [0, 6, 12]] = rotation[0, moved].T @ shift / tube.patch_scale[moved]
    centre[1, moved] += shift
    found = disagreement(tube, jet, rotation, centre)
    counted = tube.chart_weight > LEAST_WEIGHT
    counted &= counted.sum(axis=1, keepdims=True) > 1
    is_moved = tube.chart_patch == moved
    share = (tube.chart_weight * is_moved).sum(axis=1, keepdims=True)
    expected = np.linalg.norm(shift) * np.where(is_moved, 1.0 - share, share)[counted]
    assert expected.max() > 0.01
    assert_allclose(found.gap_m, np.stack([expected, expected]), rtol=1e-4, atol=1e-7)
    assert_allclose(found.normal_rad, 0.0, rtol=0.0, atol=1e-6)


def test_a_turned_patch_disagrees_by_its_angle_where_another_counts(tube):
    jet, rotation, centre = at_rest(tube)
    turned, angle = 7, 0.3
    normals = tube.patch_rotation[:, :, 2]
    across = np.cross(normals[turned], [0.0, 1.0, 0.0])
    rotation[0, turned] = rotvec_to_matrix(angle * across / np.linalg.norm(across)) @ rotation[0, turned]
    found = disagreement(tube, jet, rotation, centre)
    counted = tube.chart_weight > LEAST_WEIGHT
    overlap = counted.sum(axis=1) > 1
    by_it = ((tube.chart_patch == turned) & counted).any(axis=1)[overlap]
    assert_allclose(found.normal_rad[0, ~by_it], 0.0, rtol=0.0, atol=1e-6)
    # Off the axis of the turn a normal moves less: by the angle between n and R n.
    rest = chart_normals(tube, *at_rest(tube)[:2])[0, :, 0][overlap][by_it]
    lift = rest @ (across / np.linalg.norm(across))
    expected = 2.0 * np.arcsin(np.sin(0.5 * angle) * np.sqrt(1.0 - lift**2))
    assert_allclose(found.normal_rad[0, by_it], expected, rtol=1e-5, atol=1e-6)


@each(sheet=SHEET)
def test_normals_are_those_of_the_surface_that_each_chart_makes(sheet, rng):
    """Against central differences of the chart's map along the sheet, for any jet, frame and linear (u, v)."""
    jet = 0.3 * rng.normal(size=(2, PATCHES, jets.JET_COUNT))
    rotation = rotvec_to_matrix(rng.normal(size=(2, PATCHES, 3)))
    step = 1e-6
    sides = []
    for axis in (0, 1):
        along = np.einsum("vkba,b->vka", sheet.patch_rotation[sheet.chart_patch], step * np.eye(3)[axis])
        ends = []
        for sign in (1.0, -1.0):
            local = sheet.chart_local() + sign * along
            # (u, v) is linear in the plane: its slope follows from the sheet's own charts.
            uv = sheet.chart_uv + sign * np.einsum("vkij,vkj->vki", slope_of(sheet), along[..., :2])
            scale = sheet.patch_scale[sheet.chart_patch][..., None]
            moved = local + scale * jets.evaluate_jet(jet[:, sheet.chart_patch], uv)
            ends.append((rotation[:, sheet.chart_patch] @ moved[..., None])[..., 0])
        sides.append((ends[0] - ends[1]) / (2.0 * step))
    expected = np.cross(*sides)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    found = chart_normals(sheet, jet, rotation)
    present = np.isfinite(found).all(axis=(0, 3))
    assert present.mean() > 0.7  # charts here lie over random vertices: some hold no triangle
    assert_allclose(found[:, present], expected[:, present], rtol=0.0, atol=1e-6)


def slope_of(sheet: Garment) -> np.ndarray:
    """d(u, v) / d(x, y) (V, 4, 2, 2) of the sheet's linear charts, by least squares over each patch's entries."""
    local, slope = sheet.chart_local()[..., :2], np.zeros((*sheet.chart_patch.shape, 2, 2))
    for k in range(PATCHES):
        own = sheet.chart_patch == k
        solved, *_ = np.linalg.lstsq(local[own], sheet.chart_uv[own], rcond=None)
        slope[own] = solved.T
    return slope


def test_normals_of_a_bent_chart_are_those_of_its_mesh(tube, rng):
    """A tube: the mean of the three corners' analytic normals beside the flat triangles of what the chart draws."""
    jet, rotation, centre = at_rest(tube)
    jet[:] = 0.05 * rng.normal(size=jet.shape)
    said, normals = chart_positions(tube, jet, rotation, centre)[0], chart_normals(tube, jet, rotation)[0]
    angles = []
    for face in tube.fine_faces:
        for patch in set(tube.chart_patch[face[0]]):
            slots = tube.chart_patch[face] == patch
            if not (slots.any(axis=1) & ((tube.chart_weight[face] * slots).sum(axis=1) > LEAST_WEIGHT)).all():
                continue
            slot = slots.argmax(axis=1)
            a, b, c = said[face, slot]
            flat, mean = np.cross(b - a, c - a), normals[face, slot].sum(axis=0)
            cosine = flat @ mean / np.linalg.norm(flat) / np.linalg.norm(mean)
            angles.append(np.arccos(min(1.0, cosine)))
    assert len(angles) > 500
    assert np.percentile(angles, 95.0) < np.radians(5.0)


def test_arrays_of_another_garment_are_refused(tube):
    jet, rotation, centre = at_rest(tube)
    for wrong in [(jet[:, 1:], rotation, centre), (jet, rotation[:, 1:], centre), (jet, rotation, centre[..., :2])]:
        with pytest.raises(InputError, match="expected shape"):
            disagreement(tube, *wrong)
