"""The rows of one garment, on a model whose drape is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.cases import skinned as skin
from benchmarks.measure.detail import LowPass, dihedral_deg
from benchmarks.measure.hem import hang_mm
from benchmarks.measure.intersections import intersection_count
from benchmarks.quality import METHODS as EVERY
from benchmarks.quality import add_comparisons, measure, quality_summary
from drape.cloth import energies, metrics
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material
from drape.cloth.rest_state import modelled_rest
from drape.exact.blended_planes import blended_distance
from tests.benchmarks.quality_setup import bench, body, tube
from training.disagreement import disagreement

METHODS = tuple(method for method in EVERY if method != "folds")  # of a cloth that is no fabric
DETAIL_MM = {"skinning": 1.0, "network": 1.5, "network_push": 0.5, "physics": 3.0}


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    made = bench(tmp_path_factory.mktemp("optima"))
    return made, {row["method"]: row for row in measure(tube(), made, trained=False)}


def test_every_method_has_a_row_with_the_figures_that_apply_to_it(measured):
    _, rows = measured
    assert tuple(rows) == METHODS
    assert {row["set"] for row in rows.values()} == {"unseen"}
    for key, methods in {
        "self_intersections": set(METHODS),
        "edge_over_physics_pp": set(METHODS),
        "detail_mm": set(METHODS),
        "dihedral_deg": set(METHODS),
        "hang_mm": set(METHODS),
        "detail_share": {"network", "network_push"},
        "fabric": set(),
        "area_over_physics_pp": set(METHODS),
        "jitter_ratio": set(METHODS) - {"physics"},
        "chart_gap_p99_mm": {"network"},
        "chart_normal_p99_deg": {"network"},
        "seconds": {"physics"},
    }.items():
        assert {method for method in METHODS if key in rows[method]} == methods


def test_figures_are_those_of_the_drapes(measured):
    made, rows = measured
    poses, rest, faces = made.clip.poses, tube().vertices.astype(np.float64), tube().fine_faces
    skinned = skin(tube(), body(), poses)
    edge = metrics.edge_strain_pct(skinned, rest, faces).mean()
    assert_allclose(rows["skinning"]["edge_pct"], edge, rtol=1e-9, atol=0.0)
    assert rows["skinning"]["self_intersections"] == intersection_count(skinned, faces).mean()
    assert rows["skinning"]["self_intersections_rest"] == 0.0
    state = modelled_rest(rest, faces)
    assert rows["skinning"]["detail_mm"] == LowPass.of(state, faces, len(rest)).detail_mm(skinned).mean()
    assert rows["skinning"]["dihedral_deg"] == dihedral_deg(skinned, faces).mean()
    assert rows["skinning"]["hang_mm"] == 0.0
    draped = made.network.drape(tube(), poses)
    hang = hang_mm(draped.vertices, skinned, rest, faces).mean()
    assert_allclose(rows["network"]["hang_mm"], hang, rtol=1e-9, atol=0.0)
    charts = disagreement(tube(), draped.jet, draped.rotation, draped.centre)
    network = rows["network"]
    assert_allclose(network["chart_gap_p99_mm"], 1e3 * np.percentile(charts.gap_m, 99.0), rtol=1e-9, atol=0.0)
    cloth, contact = ClothMesh.from_rest(rest, faces), BodyContact(body().faces, body().vertex_count)
    distance = blended_distance(skinned, contact, made.clip.body_vertices, gap_m=made.material.contact_gap_m)
    contact_j = energies.contact(distance, cloth, made.material).mean()
    assert_allclose(rows["skinning"]["contact_j"], contact_j, rtol=1e-9, atol=0.0)
    assert rows["physics"]["gain"] == 1.0
    assert all(rows["physics"]["energy_j"] < rows[method]["energy_j"] for method in ("skinning_push", "network"))
    assert rows["physics"]["edge_over_physics_pp"] == 0.0
    over = rows["network"]["area_pct"] - rows["physics"]["area_pct"]
    assert_allclose(network["area_over_physics_pp"], over, rtol=1e-12, atol=0.0)


def test_a_second_model_finds_the_optimum_stored(measured, monkeypatch):
    made, rows = measured
    assert not rows["physics"]["cached"]
    monkeypatch.setattr("benchmarks.judge.physics.minimise", lambda *a, **k: pytest.fail("minimised again"))
    again = {row["method"]: row for row in measure(tube(), made, trained=True)}
    assert again["physics"]["cached"]
    assert again["physics"]["set"] == "trained"
    assert again["physics"]["energy_j"] == rows["physics"]["energy_j"]
    assert again["physics"]["seconds"] == rows["physics"]["seconds"]


def test_a_fabric_is_what_physics_and_the_energy_have_and_its_garment_rests_as_it_is_kept(measured, tmp_path):
    made, rows = measured
    rib = fabric("rib")
    state = tube().rest_state()
    bent = replace(state, hinge_angle=np.full_like(state.hinge_angle, 0.1))
    garment = replace(tube(), rest_edges=bent.edges, rest_angle=bent.hinge_angle, rest_stiffening=bent.stiffening)
    of_rib = replace(made, step_limit=120, physics_folder=tmp_path, uncorrected=made.network).of_fabric(rib)
    found = {row["method"]: row for row in measure(garment, of_rib, trained=False)}
    assert {row["fabric"] for row in found.values()} == {"rib"}
    vertices, material = made.network.made_of(rib).drape(garment, made.clip.poses).vertices, Material.of(rib)
    cloth = ClothMesh.of(bent, garment.fine_faces, len(garment.vertices))
    bending = energies.bending(vertices, cloth, material).mean()
    assert_allclose(found["network"]["bending_j"], bending, rtol=1e-9, atol=0.0)
    assert tuple(found) == EVERY and found["folds"]["gain"] > found["network"]["gain"], "folds are nearer to physics"
    assert found["folds"]["detail_share"] is not None
    assert found["physics"]["weight_n"] > 1.3 * rows["physics"]["weight_n"]
    assert len(list(tmp_path.glob("*.npz"))) == 1


def rows_of(kind: str, garment: str, energy_j: dict[str, float], edge_pct: float) -> list[dict]:
    rows = {
        method: {
            "garment": garment,
            "set": kind,
            "method": method,
            "energy_j": energy_j.get(method, 0.5),
            "edge_pct": 1.0 if method == "physics" else edge_pct,
            "area_pct": 2.0,
            "detail_mm": DETAIL_MM.get(method, 1.0),
        }
        for method in METHODS
    }
    add_comparisons(rows)
    return list(rows.values())


def test_summary_takes_each_set_alone_and_the_gain_of_the_mean_energies():
    first = {"skinning": 2.0, "skinning_push": 2.0, "network": 1.0, "network_push": 1.5}
    second = {"skinning": 3.0, "skinning_push": 4.0, "network": 2.0, "network_push": 1.5}
    rows = [
        *rows_of("trained", "a", first, 4.0),
        *rows_of("trained", "b", second, 6.0),
        *rows_of("unseen", "c", first, 9.0),
    ]
    found = {(row["set"], row["method"]): row for row in quality_summary(rows)}
    assert len(found) == 2 * len(METHODS)
    assert_allclose(found["trained", "network"]["detail_share"], 0.25, rtol=1e-12, atol=0.0)
    assert_allclose(found["trained", "network_push"]["detail_share"], -0.25, rtol=1e-12, atol=0.0)
    gains = [found["trained", method]["gain"] for method in ("skinning_push", "network", "physics")]
    assert_allclose(gains, [0.0, 0.6, 1.0], rtol=1e-12, atol=0.0)
    assert_allclose(found["trained", "network"]["edge_over_physics_pp"], 4.0, rtol=1e-12, atol=0.0)
    assert_allclose(found["unseen", "network"]["gain"], 1.0 / 1.5, rtol=1e-12, atol=0.0)
    assert_allclose(found["unseen", "network"]["edge_over_physics_pp"], 8.0, rtol=1e-12, atol=0.0)


def test_fabrics_are_summed_up_one_by_one():
    energy_j = {"skinning": 2.0, "skinning_push": 2.0, "network": 1.0, "network_push": 1.5}
    rows = [
        row | {"fabric": name}
        for name, edge_pct in (("jersey", 4.0), ("denim", 6.0))
        for row in rows_of("trained", "a", energy_j, edge_pct)
    ]
    found = {(row["fabric"], row["method"]): row for row in quality_summary(rows)}
    assert len(found) == 2 * len(METHODS)
    assert [found[name, "network"]["edge_pct"] for name in ("jersey", "denim")] == [4.0, 6.0]


def test_where_physics_has_no_more_detail_than_skinning_there_is_no_share():
    rows = {row["method"]: row | {"detail_mm": 1.0} for row in rows_of("trained", "a", {}, 4.0)}
    add_comparisons(rows)
    assert np.isnan(rows["network"]["detail_share"])
