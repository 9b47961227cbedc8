"""Hidden garments of an outfit: nothing of them comes, and nothing is computed but what visible ones feel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.garment.cache import Garment
from drape.wire import messages as wire
from drape.wire.jets import unpack_jets
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.graphs.push import Pusher
from service.settings import Settings
from service.stages import run
from service.stages.batch import Batch, Plan, PoseInput, joined
from tests.fixtures.poses import smooth_motion
from tests.fixtures.serving import outfit_settings, outfit_url

__all__ = ["outfit_settings", "outfit_url"]  # fixtures
POSES, TRANS = smooth_motion(np.arange(3) / 30.0)
WORN = ["tube", "coat", "cape"]


@pytest.fixture(scope="module")
def runtime(outfit_settings: Settings) -> Iterator[DrapeRuntime]:
    made = DrapeRuntime(outfit_settings)
    yield made
    made.close()


def planned(runtime: DrapeRuntime, worn: list[str] | None = None, *, messages: bool = False, **options: Any) -> Plan:
    asked = DrapeOptions.model_validate(options)
    plan = runtime.plan(runtime.garments.scene(None, worn or WORN), asked, messages=messages)
    for stage in plan.stages:
        stage.prepare(plan)
    return plan


def draped(plan: Plan) -> Batch:
    return run(plan, [PoseInput(POSES, TRANS, np.zeros(10), np.arange(3) / 30.0)])


def ids(plan: Plan) -> list[str]:
    return [entry.id for entry in plan.scene.layers]


@pytest.mark.parametrize(
    ("hidden", "felt", "computed", "shown"),
    [
        (["cape"], True, ["tube", "coat"], ["tube", "coat"]),  # nothing lies over it
        (["coat", "cape"], True, ["tube"], ["tube"]),
        (["tube"], True, ["tube", "coat", "cape"], ["coat", "cape"]),
        (["tube", "cape"], True, ["tube", "coat"], ["coat"]),
        (["tube"], False, ["coat", "cape"], ["coat", "cape"]),
        (["coat"], False, ["tube", "cape"], ["tube", "cape"]),
    ],
)
def test_a_plan_holds_no_hidden_garment_that_no_visible_one_feels(
    runtime: DrapeRuntime, hidden: list[str], felt: bool, computed: list[str], shown: list[str]
):
    plan = planned(runtime, hidden=hidden, push_out=felt)
    assert ids(plan) == computed and [entry.id for entry in plan.shown.layers] == shown
    assert len(plan.draped) == len(computed) and set(plan.options.hidden or ()) == set(computed) - set(shown)
    if plan.options.hidden is None:
        alone = planned(runtime, computed, push_out=felt)
        assert plan.options == alone.options and plan.draped == alone.draped, "no more than an outfit without it"


@pytest.mark.parametrize(
    "options",
    [{}, {"push_out": False}, {"folds": 1}, {"folds": 1, "cloth_contact": False}, {"folds": 1, "push_out": False}],
)
@pytest.mark.parametrize("hidden", [["tube"], ["coat"], ["cape"], ["tube", "cape"]])
def test_visible_garments_are_to_the_bit_those_of_the_whole_outfit(
    runtime: DrapeRuntime, hidden: list[str], options: dict
):
    whole, less = draped(planned(runtime, **options)), draped(planned(runtime, hidden=hidden, **options))
    seen = [layer.vertices for layer, name in zip(whole.layers, WORN, strict=True) if name not in hidden]
    assert_array_equal(less.vertices, joined(seen))


def test_messages_hold_the_visible_garments_alone(runtime: DrapeRuntime, tube: Garment):
    whole = draped(planned(runtime, messages=True)).messages[0]
    less = draped(planned(runtime, hidden=["tube"], messages=True)).messages[0]
    payload = len(less) - wire.FRAME_HEADER_BYTES
    assert payload == 2 * 6 * tube.vertex_count == (len(whole) - wire.FRAME_HEADER_BYTES) * 2 // 3


def test_jets_of_hidden_garments_are_neither_pushed_nor_sent(runtime: DrapeRuntime, monkeypatch: pytest.MonkeyPatch):
    whole = draped(planned(runtime, messages=True, geometry="jets"))
    posed: list[bool] = []
    push = Pusher.push

    def noted(*arguments: Any, **named: Any) -> Any:
        posed.append(named["posed"] is not None)
        return push(*arguments, **named)

    monkeypatch.setattr(Pusher, "push", noted)
    less = draped(planned(runtime, messages=True, geometry="jets", hidden=["tube"]))
    assert posed == [False, True, True]
    patches = runtime.garments.get("tube").patch_count
    assert_array_equal(less.jets.jet, whole.jets.jet[:, patches:])
    assert [len(unpack_jets(one).jet) for one in less.messages] == [2 * patches] * 3


def test_of_hidden_garments_a_clip_keeps_nothing(runtime: DrapeRuntime):
    answer = draped(planned(runtime, hidden=["tube"])).answer()
    assert answer.layers[0].vertices is None and all(layer.vertices is not None for layer in answer.layers[1:])


def test_what_is_pushed_is_told_of_visible_garments_alone(runtime: DrapeRuntime):
    whole, less = (
        draped(planned(runtime, ["tube", "coat"])),
        draped(planned(runtime, ["tube", "coat"], hidden=["tube"])),
    )
    inner = draped(planned(runtime, ["tube"])).quality.pushed_share
    assert_array_equal(less.quality.pushed_share, 2.0 * whole.quality.pushed_share - inner)


def test_steps_of_a_stream_hide_what_the_stream_hides(runtime: DrapeRuntime):
    plan = planned(runtime, hidden=["tube", "cape"], folds=4, messages=True)
    for step in runtime.steps(plan):
        assert step.shown == plan.shown and step.keys == plan.keys


def ask(url: str, **fields: object) -> httpx.Response:
    return httpx.post(f"{url}/drape", json={"poses": POSES.tolist(), **fields}, timeout=60.0)


def test_answers_name_the_visible_garments(outfit_url: str, tube: Garment):
    whole, less = (
        ask(outfit_url, garments=["tube", "coat"]),
        ask(outfit_url, garments=["tube", "coat"], hidden=["tube"]),
    )
    assert less.headers["X-Drape-Garments"] == f"coat:{tube.vertex_count}"
    assert less.headers["X-Drape-Vertices"] == str(tube.vertex_count)
    both = np.frombuffer(whole.content, "<f4").reshape(3, 2, tube.vertex_count, 3)
    assert_array_equal(np.frombuffer(less.content, "<f4").reshape(3, tube.vertex_count, 3), both[:, 1])


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"garments": ["tube", "coat"], "hidden": ["cape"]}, "some of: tube, coat"),
        ({"garments": ["tube", "coat"], "hidden": ["tube", "coat"]}, "one visible garment"),
        ({"garment": "tube", "hidden": ["tube"]}, "one visible garment"),
        ({"garments": ["tube", "coat"], "hidden": []}, "hidden"),
    ],
)
def test_what_cannot_be_hidden_is_refused(outfit_url: str, fields: dict, word: str):
    answer = ask(outfit_url, **fields)
    assert answer.status_code == 400 and word in answer.text
