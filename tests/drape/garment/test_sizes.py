"""Sizes: the chart, the tables beside the shipped garments, and a garment that is made in another size."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.measures import measures
from drape.body.model import BodyModel
from drape.errors import ArtifactError, NotFound
from drape.garment.cache import GARMENTS_DIR, Garment
from drape.garment.clearance import CLEARANCE_M
from drape.garment.size_chart import GIRTH_STEP_M, SIZES, advice, check_size, cut_for, deciding
from drape.garment.sizes import (
    GROWN_STEP_M,
    MOVED_STEP_M,
    OTHERS,
    field_in_panels,
    field_in_space,
    load_table,
    moved_patches,
    regraded,
    save_table,
    sized,
    sized_digest,
    table_path,
)
from drape.geometry.closest import signed_distance
from tests.fixtures.garments import SHIPPED, reconstructed, shipped, tube_sizes

STANDARD = {"chest_m": 0.95, "waist_m": 0.79, "hip_m": 1.01}


def test_letters_join_without_a_gap_and_m_is_the_standard_body():
    ranges = [cut_for(size, STANDARD)["chest_m"] for size in SIZES]
    assert_allclose([most - least for least, most in ranges], GIRTH_STEP_M)
    assert_allclose([most for _, most in ranges[:-1]], [least for least, _ in ranges[1:]])
    assert_allclose(np.mean(cut_for("M", STANDARD)["hip_m"]), STANDARD["hip_m"])


@pytest.mark.parametrize(
    ("more_m", "size", "words"),
    [
        ({}, "M", "chest 95 cm; M is cut for 91 to 99 cm"),
        ({"chest_m": 0.039}, "M", "chest 99 cm; M is cut for 91 to 99 cm"),
        ({"chest_m": 0.041}, "L", "chest 99 cm; L is cut for 99 to 107 cm"),
        ({"chest_m": -0.08}, "S", "chest 87 cm; S is cut for 83 to 91 cm"),
        ({"chest_m": 0.3}, "XL", "chest 125 cm; XL is cut for 107 to 115 cm, the largest"),
        ({"chest_m": -0.2}, "S", "chest 75 cm; S is cut for 83 to 91 cm, the smallest"),
    ],
)
def test_a_chest_takes_the_size_that_is_cut_for_it(more_m: dict[str, float], size: str, words: str):
    girths = {name: girth + more_m.get(name, 0.0) for name, girth in STANDARD.items()}
    assert advice(girths, STANDARD, ("chest_m",)) == (size, words)


def test_trousers_go_by_the_wider_of_waist_and_hips():
    levels = deciding({"waist_m": 0.8, "hip_m": 1.0, "length_m": 1.0})
    assert levels == ("waist_m", "hip_m") and deciding({"chest_m": 1.0, "hip_m": 1.0}) == ("chest_m",)
    assert advice(STANDARD | {"hip_m": 1.09}, STANDARD, levels).words.startswith("hips 109 cm; L")
    assert advice(STANDARD | {"waist_m": 0.95}, STANDARD, levels).size == "XL"


@pytest.mark.parametrize(
    ("size", "cure"),
    [
        ("XXL", "nearest is XL"),
        ("xs", "nearest is S"),
        ("l", "nearest is L"),
        ("Xl ", "nearest is XL"),
        ("7", "one of"),
    ],
)
def test_a_size_that_there_is_not_is_told_with_the_nearest(size: str, cure: str):
    with pytest.raises(NotFound, match=rf"size: expected one of S, M, L, XL of tshirt, got {size}.*{cure}"):
        check_size(size, "tshirt")


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_garment_grows_from_size_to_size(name: str):
    garment = shipped(name)
    table = load_table(table_path(GARMENTS_DIR, garment), garment)
    assert tuple(table.measures) == SIZES and table.moved.shape[0] == len(OTHERS)
    lengths = [table.measures[size]["length_m"] for size in SIZES]
    if name == "circle_skirt":  # half of it is cut from one width of cloth
        assert_allclose(lengths, lengths[1], atol=0.005)
    else:
        assert (np.diff(lengths) > 0.0).all()
    for measure in table.measures["M"].keys() - {"length_m"}:
        numbers = [table.measures[size][measure] for size in SIZES if measure in table.measures[size]]
        assert (np.diff(numbers) > 0.0).all(), (measure, numbers)
    level = deciding(table.measures["M"])[0]
    grown = table.measures["XL"][level] - table.measures["S"][level]
    assert_allclose(grown, 3 * GIRTH_STEP_M, rtol=0.15)  # rings are not level; the sweat's cut its deep armholes
    assert table.vertex.max() < garment.vertex_count and table.corner.max() < len(garment.uv)


def test_fields_have_what_is_given_and_panels_what_is_linear(tube: Garment):
    points, random = tube.vertices.astype(float), np.random.default_rng(0)
    rows = random.choice(len(points), 20, replace=False)
    values = random.normal(size=(20, 3))
    assert_allclose(field_in_space(points, rows, values)[rows], values, atol=1e-9)
    uv = tube.uv.astype(float)
    linear = uv @ random.normal(size=(2, 2)) + [0.3, -0.2]
    rows = np.array([0, 24, 100, 150, 200, 224])
    assert_allclose(field_in_panels(uv, tube.uv_faces, rows, linear[rows]), linear, atol=1e-9)


def test_cloth_grows_as_its_panels_do():
    random = np.random.default_rng(0)
    uv, faces, edges = random.normal(size=(12, 2)), np.arange(12).reshape(-1, 3), random.normal(size=(4, 2, 2))
    assert_allclose(regraded(edges, uv, uv + np.array([0.2, 0.1]), faces), edges, rtol=1e-9)
    assert_allclose(regraded(edges, uv, 1.1 * uv, faces), 1.1 * edges, rtol=1e-9)
    # The edges of a triangle along (warp, weft) = (v, u).
    laid = np.stack([uv[faces[:, k]] - uv[faces[:, 0]] for k in (1, 2)], axis=1)[..., ::-1]
    wider = regraded(laid, uv, uv * [1.3, 1.0], faces)
    assert_allclose(wider, laid * [1.0, 1.3], rtol=1e-9)


@pytest.fixture(scope="module")
def large(tube: Garment, body: BodyModel) -> Garment:
    return sized(tube, body, tube_sizes(tube), "XL")


def test_a_large_one_is_wider_in_cloth_and_in_place(large: Garment, tube: Garment, body: BodyModel):
    radii = [np.hypot(one.vertices[:, 0], one.vertices[:, 2]).mean() for one in (tube, large)]
    assert radii[1] > radii[0] + 0.02
    ratio = large.rest_state().edges / np.where(tube.rest_state().edges == 0.0, np.nan, tube.rest_state().edges)
    assert 1.1 < np.nanmedian(ratio[..., 1]) < 1.2  # along the weft
    assert signed_distance(large.vertices.astype(float), body.v_template, body.faces).min() >= CLEARANCE_M - 1e-6


def test_it_keeps_its_mesh_its_cloth_and_its_name(large: Garment, tube: Garment, body: BodyModel):
    table = tube_sizes(tube)
    assert (large.name, large.fabric, large.body_digest) == (tube.name, tube.fabric, body.digest)
    assert (large.faces == tube.faces).all() and (large.uv_faces == tube.uv_faces).all()
    assert large.patch_count == tube.patch_count and large.uv.max() > tube.uv.max()
    assert large.digest == sized_digest(tube, table, "XL") != sized_digest(tube, table, "L")
    assert sized(tube, body, table, "M") is tube


def test_where_nothing_moves_patches_and_charts_stay_what_they_are(body: BodyModel):
    garment = shipped("tank")
    same = moved_patches(garment, garment.vertices.astype(float), body)
    flat = (garment.patch_jet[:, :12] != np.eye(12)[1] + np.eye(12)[8]).any(axis=1)
    assert 0 < flat.sum() < len(flat), "both kinds of charts"
    for name, array in same.items():
        unit = 0.05 if name == "patch_features" else 2e-5  # whose seeds are the nearest vertices, not the cluster's
        assert_allclose(array, getattr(garment, name), atol=unit, err_msg=name)


def test_charts_hold_the_cloth_where_it_lies_now(large: Garment):
    assert_allclose(reconstructed(large), large.vertices, atol=1e-6)


def test_a_table_comes_back_to_half_a_step(tube: Garment, tmp_path: Path):
    table, path = tube_sizes(tube), table_path(tmp_path, tube)
    save_table(table, path)
    read = load_table(path, tube)
    assert_allclose(read.moved, table.moved, atol=0.5 * MOVED_STEP_M + 1e-12)
    assert_allclose(read.grown, table.grown, atol=0.5 * GROWN_STEP_M + 1e-12)
    assert (read.vertex == table.vertex).all() and (read.corner == table.corner).all()
    assert read.measures == table.measures
    with pytest.raises(ArtifactError, match="expected sizes of"):
        load_table(path, replace(tube, digest="other"))
    path.write_bytes(b"no table")
    with pytest.raises(ArtifactError, match="expected a table of sizes"):
        load_table(path, tube)


def test_the_standard_body_takes_m(body: BodyModel):
    girths = measures(body)._asdict()
    assert advice(girths, girths, ("waist_m", "hip_m")).size == "M"
