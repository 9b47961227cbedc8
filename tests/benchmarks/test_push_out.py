"""The comparison of push-outs: rivals against closed forms, and one small run."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from benchmarks import push_out, push_rivals
from benchmarks.push_out import METHODS, rest_candidates, summary
from drape.body.assets import load_body
from drape.geometry import closest, meshes


@pytest.fixture(scope="module")
def inside():
    """Points 5 mm inside the left thigh and the trunk of the body in T-pose, and nobody's pose."""
    body = load_body()
    rng = np.random.default_rng(0)
    chosen = rng.choice(np.flatnonzero(body.weights[:, [1, 3, 6]].max(axis=1) > 0.8), 60, replace=False)
    normals = meshes.vertex_normals(body.v_template, body.faces)
    rotations, translations = (torch.from_numpy(x.astype(np.float32)) for x in body.bones(np.zeros((1, 24, 3))))
    return body.v_template[chosen] - 0.005 * normals[chosen], rotations, translations


@pytest.mark.parametrize("name", ["rest_candidates", "distance_grids"])
def test_a_rival_brings_points_out_to_the_clearance(inside, name: str):
    points, rotations, translations = inside
    body = load_body()
    module = (
        push_rivals.DistanceGrids(body, 0.004, cells=14)
        if name == "distance_grids"
        else rest_candidates(body, points, 0.004)
    )
    out = module(torch.from_numpy(points[None].astype(np.float32)), rotations, translations)[0].double().numpy()
    distance = closest.signed_distance(out, body.v_template, body.faces)
    assert_allclose(np.median(distance), 0.004, rtol=0, atol=0.002)
    assert (distance > 0.0).mean() > 0.85


def test_capsules_push_along_the_way_from_the_bone():
    body = load_body()
    capsules = push_rivals.Capsules(body, 0.0)
    rotations, translations = (torch.from_numpy(x.astype(np.float32)) for x in body.bones(np.zeros((1, 24, 3))))
    knee, hip = body.joints_template[4], body.joints_template[1]
    middle = 0.5 * (knee + hip)
    way = np.cross(knee - hip, [0.0, 0.0, 1.0])
    way /= np.linalg.norm(way)
    points = torch.from_numpy((middle + 0.02 * way)[None, None].astype(np.float32))
    out = capsules(points, rotations, translations)[0, 0].double().numpy()
    assert_allclose(out, middle + float(capsules.get_buffer("radius")[1]) * way, rtol=0, atol=1e-4)


def test_the_summary_is_the_mean_of_each_set():
    rows = [
        {"garment": name, "set": kind, "method": method, "edge_pct": value}
        for name, kind, value in (("a", "trained", 1.0), ("b", "trained", 3.0), ("c", "unseen", 7.0))
        for method in METHODS
    ]
    found = {(row["set"], row["method"]): row for row in summary(rows)}
    assert found["trained", "capsules"]["edge_pct"] == 2.0
    assert found["unseen", "none"]["garment"] == "mean of 1"


@pytest.mark.slow
def test_a_small_run_has_every_method_and_ours_collides_least(capsys):
    record = push_out.main(["--quick", "--threads", "1", "--garments", "shorts", "--motions", "squat"])
    rows = {row["method"]: row for row in record["rows"]}
    assert set(rows) == set(METHODS)
    assert "processor_ms" not in rows["none"]
    assert all(rows[method]["p50_ms"] > 0.0 for method in METHODS if method != "none")
    assert rows["own_and_other"]["colliding_triangle_pct"] <= rows["none"]["colliding_triangle_pct"]
    assert rows["none"]["edge_added_pp"] == 0.0
    assert "own_and_other" in capsys.readouterr().out
