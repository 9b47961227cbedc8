"""Swing as a stage: who has it, what it remembers, and that it is the same alone, beside others and in pieces."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.model import BodyModel
from drape.catalog import find_garments, open_garment
from drape.cloth.fabric_table import fabric
from drape.errors import InputError
from drape.live.swing_constants import swing_constants
from drape.stages.batch import PoseInput
from drape.stages.plan import Plan
from drape.stages.swing import Swing
from drape.stages.walk import run
from drape.wire.options import Advanced, DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.replicas.memory_codec import decode_value, encode_value
from service.settings import load_settings

TIMES_S = np.arange(14) / 30.0
NO_SHAPE = np.zeros(10)


@pytest.fixture(scope="module")
def runtime(make_runtime: Callable[..., DrapeRuntime]) -> DrapeRuntime:
    return make_runtime(inertia="mesh")


def plan_of(runtime: DrapeRuntime, **options: object) -> Plan:
    return runtime.plan(runtime.garments.get("tube"), DrapeOptions(**({"push_out": False} | options)))  # pyright: ignore[reportArgumentType]


def started(way_m: float = 1.0) -> PoseInput:
    """A body at rest that sets off sideways."""
    trans = np.zeros((len(TIMES_S), 3))
    trans[:, 0] = way_m * np.maximum(TIMES_S - TIMES_S[4], 0.0) ** 2
    return PoseInput(np.zeros((len(TIMES_S), 24, 3)), trans, NO_SHAPE, TIMES_S)


def test_what_hangs_lags_and_what_is_held_does_not(runtime: DrapeRuntime):
    plan = plan_of(runtime)
    assert [stage.name for stage in plan.stages] == ["network", "swing"]
    still = run(plan_of(runtime, motion=0.0), [started()])
    swung = run(plan, [started()])
    assert still.memories == ({},) and [stage for stage, _ in swung.memories[0]] == ["swing"]
    assert_array_equal(swung.vertices[:5], still.vertices[:5])
    behind = (swung.vertices - still.vertices)[-1]
    lag = -behind[:, 0]
    assert lag.max() > 0.005 and np.median(np.abs(behind).max(axis=1)) < 0.5 * lag.max()
    half = run(plan_of(runtime, motion=0.5), [started()])
    assert_allclose(half.vertices - still.vertices, 0.5 * (swung.vertices - still.vertices), atol=1e-6)
    single = run(plan, [started().part(slice(9, 10), {})])
    assert_array_equal(single.vertices, still.vertices[9:10])


def test_it_is_the_same_beside_others_and_in_pieces(runtime: DrapeRuntime, make_runtime: Callable[..., DrapeRuntime]):
    plan, inputs = plan_of(runtime), [started(), started(-0.5).part(slice(0, 9), {})]
    together = run(plan, inputs)
    assert_array_equal(together.vertices, np.concatenate([run(plan, [one]).vertices for one in inputs]))
    pieces = make_runtime(inertia="mesh", chunk_frames=3)
    draped = asyncio.run(pieces.drape(plan_of(pieces), inputs[0]))
    assert_array_equal(draped.vertices, together.vertices[: len(TIMES_S)])


def test_what_it_remembers_can_move(runtime: DrapeRuntime):
    plan, clip = plan_of(runtime), started()
    whole = run(plan, [clip])
    first = run(plan, [clip.part(slice(0, 9), {})])
    (stage,) = [stage for stage in plan.stages if stage.name == "swing"]
    key = ("swing", plan.draped_keys[0])
    moved = decode_value(encode_value(first.memories[0][key], stage.kept), stage.kept)
    after = run(plan, [clip.part(slice(9, len(TIMES_S)), {key: moved})])
    assert_array_equal(after.vertices, whole.vertices[9:])


def test_jets_have_none(runtime: DrapeRuntime):
    assert plan_of(runtime, geometry="jets").options.advanced.inertia == "network"
    with pytest.raises(InputError, match=r"^advanced\.inertia: expected network with geometry jets"):
        plan_of(runtime, geometry="jets", inertia="mesh")


def test_the_service_says_what_holds_where_nobody_does(make_runtime: Callable[..., DrapeRuntime]):
    assert load_settings().inertia == "mesh"
    other = make_runtime()
    plan = other.plan(other.garments.get("tube"), DrapeOptions(advanced=Advanced(push_out=False)))
    assert plan.options.advanced.inertia == "network"
    assert plan.options.knob == 0.0, "a static model has learned no motion"
    assert other.plan(other.garments.get("tube"), DrapeOptions(advanced=Advanced(inertia="mesh"))).options.knob == 1.0


def test_a_garment_that_is_gone_leaves_nothing(runtime: DrapeRuntime):
    plan = plan_of(runtime, fabric="denim")
    (stage,) = [stage for stage in plan.stages if isinstance(stage, Swing)]
    run(plan, [started()])
    assert any(key == plan.draped_keys[0] for key, _ in stage._constants)
    stage.remove(stage._garments[plan.draped_keys[0]])
    assert not any(key == plan.draped_keys[0] for key, _ in stage._constants)


def test_a_fabric_has_its_mass_and_stiffness(body: BodyModel):
    skirt = open_garment(find_garments(["skirt"])[0], body)
    made = swing_constants(skirt, body, fabric("denim"))
    assert made is not None
    light = swing_constants(skirt, body, fabric("chiffon"))
    assert light is not None
    assert made.young_n_per_m == light.young_n_per_m == 300.0
    assert_allclose(made.mesh.mass_kg / light.mesh.mass_kg, 0.407 / 0.06, rtol=1e-3)
    assert made.nbytes < 1 << 21
