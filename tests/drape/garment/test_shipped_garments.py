"""The shipped garments hold what the product promises of them."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from drape.garment.cache import GARMENTS_DIR
from drape.garment.fitting import fit_error, rest_garment
from drape.geometry.closest import signed_distance
from drape.geometry.meshes import signed_areas
from recovery.catalogue.cuts import CATALOGUE
from tests.fixtures.garments import SHIPPED, default_body, reconstructed, shipped
from tests.fixtures.laws import each
from tests.recovery.pattern_setup import default_measurements

CLEARANCE_M = 0.006
FILE_LIMIT_BYTES = 1_300_000
MICROMETRE = 1e-6
for_each_garment = each(name=SHIPPED)


def test_they_are_the_catalogue_under_its_digests():
    assert set(SHIPPED) == set(CATALOGUE)
    files = {path.name for path in GARMENTS_DIR.glob("*.npz")}
    assert files == {shipped(name).file_name() for name in SHIPPED}


@for_each_garment
def test_a_sewn_one_rests_as_its_panels_in_its_fabric(name):
    garment, made = shipped(name), CATALOGUE[name](default_measurements())
    assert garment.fabric == made.fabric
    assert garment.manifest["rest"]["lengths"] == "panels" and garment.manifest["rest"]["grain"] == "uv"
    state = garment.rest_state()
    cut = np.abs(signed_areas(garment.uv.astype(np.float64), garment.uv_faces))
    assert_allclose(state.face_area.sum(), cut.sum(), rtol=1e-5, atol=0.0)
    assert {0.0, *made.seam_angles.values()} == {round(float(angle), 6) for angle in np.unique(state.hinge_angle)}
    assert set(np.unique(state.stiffening)) == {1.0, 2.0}


@for_each_garment
def test_file_is_small_its_numbers_finite_and_its_indices_in_range(name):
    garment = shipped(name)
    assert (GARMENTS_DIR / garment.file_name()).stat().st_size < FILE_LIMIT_BYTES
    assert garment.body_digest == default_body().digest
    for key, value in vars(garment).items():
        if isinstance(value, np.ndarray):
            assert np.isfinite(value).all(), key
    assert garment.vertex_count <= len(garment.vertices)
    assert garment.faces.min() >= 0 and garment.faces.max() < garment.vertex_count
    assert garment.fine_faces.min() >= 0 and garment.fine_faces.max() < len(garment.vertices)
    assert garment.chart_patch.min() >= 0 and garment.chart_patch.max() < garment.patch_count
    assert len(garment.face_material) == len(garment.faces)
    assert len(garment.uv_faces) in (0, len(garment.faces))


@for_each_garment
def test_patches_give_back_the_vertices(name):
    garment = shipped(name)
    assert_allclose(reconstructed(garment), garment.vertices, rtol=0.0, atol=MICROMETRE)


@for_each_garment
def test_weights_are_partitions_of_unity(name):
    garment = shipped(name)
    for weight in (garment.chart_weight, garment.skin_weights(default_body()), garment.patch_weights):
        assert weight.min() >= 0.0
        assert_allclose(weight.sum(axis=1), 1.0, rtol=0.0, atol=1e-5)


@for_each_garment
def test_it_keeps_clear_of_the_body(name):
    body = default_body()
    assert signed_distance(shipped(name).vertices, body.v_template, body.faces).min() >= CLEARANCE_M


@for_each_garment
def test_patches_and_fit_are_as_its_manifest_says(name):
    garment = shipped(name)
    rest = rest_garment(garment.vertices, garment.fine_faces, default_body())
    figures = garment.manifest["fit"]
    assert figures["patch_count"] == garment.patch_count
    assert 100 <= garment.patch_count <= 400
    assert_allclose(rest.areas.sum(), figures["area_m2"], rtol=1e-4, atol=0.0)
    fields = {key: getattr(garment, key) for key in vars(garment) if key.startswith(("patch_", "chart_"))}
    measured = fit_error(rest, fields)
    assert measured["folded_chart_entries"] == figures["folded_chart_entries"]
    # Charts of the cut ones are projections, which a jet cannot lean past; those of the others were laid flat.
    folds = {"folded_chart_triangles", "folded_charts"} & set(figures) or {"folded_chart_entries"}
    assert {key: measured[key] for key in folds} == dict.fromkeys(folds, 0)
    for key in ("point_rmse_m", "point_max_m", "normal_error_deg"):
        assert_allclose(measured[key], figures[key], rtol=1e-2, atol=1e-6)
