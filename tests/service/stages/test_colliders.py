"""Colliders as a stage and through REST: vertices stay outside, whatever is computed, and wherever the body stands."""

from __future__ import annotations

from collections.abc import Callable

import httpx
import numpy as np
import pytest

from drape.errors import InputError
from drape.geometry.colliders import distances
from drape.stages.batch import PoseInput
from drape.stages.plan import Plan
from drape.stages.walk import run
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime

WALL = {"kind": "plane", "normal": [1.0, 0.0, 0.0]}
TIMES_S = np.arange(4) / 30.0


@pytest.fixture(scope="module")
def runtime(make_runtime: Callable[..., DrapeRuntime]) -> DrapeRuntime:
    return make_runtime()


def plan_of(runtime: DrapeRuntime, **options: object) -> Plan:
    scene = runtime.garments.get("tube")
    return runtime.plan(scene, DrapeOptions.model_validate({"push_out": False} | options))


def standing(trans: np.ndarray) -> PoseInput:
    return PoseInput(np.zeros((4, 24, 3)), np.tile(trans, (4, 1)), np.zeros(10), TIMES_S)


@pytest.mark.parametrize("chosen", [{"folds": 0}, {"folds": 1}, {"folds": 0, "inertia": "mesh"}])
def test_cloth_stays_outside_wherever_the_body_stands(runtime: DrapeRuntime, chosen: dict[str, object]):
    trans = np.array([3.0, -1.0, 0.5])
    free = run(plan_of(runtime, **chosen), [standing(trans)]).world()[-1]
    offset_m = float(np.quantile(free[:, 0], 0.1))
    plan = plan_of(runtime, colliders=[WALL | {"offset_m": offset_m}], **chosen)
    for stage in plan.stages:
        stage.prepare(plan)
    found = run(plan, [standing(trans)]).world()[-1]
    assert distances(plan.colliders, free).min() < -0.003
    # Skin stands in this wall: cloth on it may be as deep.
    assert np.quantile(distances(plan.colliders, found), 0.05) > -1e-4
    assert np.abs(found - free).max() > 0.003


def test_no_collider_is_none(runtime: DrapeRuntime):
    assert plan_of(runtime, colliders=[]) == plan_of(runtime)
    assert "colliders" not in [stage.name for stage in plan_of(runtime).stages]


def test_jets_lie_on_nothing(runtime: DrapeRuntime):
    with pytest.raises(InputError, match="colliders"):
        plan_of(runtime, geometry="jets", colliders=[WALL])


def test_they_come_by_rest_and_mistakes_are_told(api: httpx.Client):
    body = {"garment": "tube", "poses": np.zeros((1, 24, 3)).tolist(), "trans": [[0.0, 0.9, 0.0]], "folds": 0}
    floor_m = 1.0
    floor = [{"kind": "plane", "offset_m": floor_m}]
    answer = api.post("/drape", json=body | {"colliders": floor}, headers={"Accept": "application/octet-stream"})
    assert answer.status_code == 200
    vertices = np.frombuffer(answer.content, "<f4").reshape(-1, 3)
    assert vertices[:, 1].min() > floor_m - 1e-3
    refused = api.post("/drape", json=body | {"colliders": [{"kind": "box", "centre": [0, 0, 0]}]})
    assert refused.status_code in (400, 422) and "size" in refused.text
    for wrong, expected in (
        ({"type": "plane"}, "'kind'"),
        ({"kind": "planes"}, "'kind': one of 'plane', 'box', 'capsule'"),
    ):
        told = api.post("/drape", json=body | {"colliders": [wrong]}).json()
        assert (told["name"], told["expected"]) == ("colliders[0]", expected)
