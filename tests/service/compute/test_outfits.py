"""Garments over each other: layers, limits and refusals, and hidden ones of which no more is computed than is felt."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.errors import InputError, NotFound, TooLarge
from drape.garment.cache import Garment
from drape.inference.engine import Engine
from drape.stages.batch import Batch, PoseInput, concatenated
from drape.stages.collision import KEPT_OUTFITS, Pusher
from drape.stages.plan import Plan
from drape.stages.scene import Outfit
from drape.stages.walk import run
from drape.wire import messages as wire
from drape.wire.jets import unpack_jets
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.layers import through_pct
from tests.fixtures.poses import random_motion, smooth_motion
from tests.fixtures.serving import vertices_of
from tests.fixtures.streams import raw_stream
from tests.fixtures.tiny_model import TINY
from tests.service.graphs.test_push import added

BINARY, GLB, JSON = "application/octet-stream", "model/gltf-binary", "application/json"
POSES = random_motion(2, spread_rad=0.2)[0]


def ask(client: httpx.Client, accept: str = BINARY, **fields: object) -> httpx.Response:
    document = {"poses": POSES.tolist(), **fields}
    return client.post("/drape", json=document, headers={"Accept": accept})


def test_layers_come_one_after_the_other_and_out_of_each_other(client: httpx.Client, tube: Garment):
    response = ask(client, garments=["tube", "coat"])
    count, faces = tube.vertex_count, tube.faces.astype(np.int64)
    assert response.headers["X-Drape-Garments"] == f"tube:{count},coat:{count}"
    whole = vertices_of(response).astype(np.float64)
    inner, outer = whole[:, :count], whole[:, count:]
    alone = [vertices_of(ask(client, garment=name)).astype(np.float64) for name in ("tube", "coat")]
    assert_array_equal(inner, alone[0])  # what lies over it does not move the innermost
    before, after = through_pct(alone[1], inner, faces), through_pct(outer, inner, faces)
    assert before.min() > 10.0, "must be through for the test to mean something"
    assert (after < 0.1 * before).all()  # triangles of 5 x 8 cm are coarser than the samples can follow
    assert float(response.headers["X-Drape-Pushed-Share"]) > 0.1


def test_without_push_out_the_layers_are_the_garments_alone(client: httpx.Client):
    whole = vertices_of(ask(client, garments=["tube", "coat"], push_out=False))
    alone = [vertices_of(ask(client, garment=name, push_out=False)) for name in ("tube", "coat")]
    assert_array_equal(whole, np.concatenate(alone, axis=1))


def test_one_garment_is_answered_as_ever_however_it_is_named(client: httpx.Client):
    one, listed = ask(client, JSON, garment="coat"), ask(client, JSON, garments=["coat"])
    assert one.content == listed.content
    assert set(one.json()) == {"fps", "frames", "vertices", "positions", "origin"}
    assert "X-Drape-Garments" not in one.headers


def test_json_and_glb_hold_every_layer(client: httpx.Client, tube: Garment):
    document = ask(client, JSON, garments=["coat", "tube"]).json()
    count = tube.vertex_count
    assert document["garments"] == [{"id": "coat", "vertices": count}, {"id": "tube", "vertices": count}]
    whole = vertices_of(ask(client, garments=["coat", "tube"]))
    assert_array_equal(np.float32(document["positions"]), whole)
    content = ask(client, GLB, garments=["coat", "tube"]).content
    size = int.from_bytes(content[12:16], "little")
    parsed = json.loads(content[20 : 20 + size])
    assert [mesh["name"] for mesh in parsed["meshes"]] == ["coat", "tube"]
    colours = [material["pbrMetallicRoughness"]["baseColorFactor"] for material in parsed["materials"]]
    assert colours[0] == colours[1] != colours[2] == colours[3]


@pytest.mark.parametrize(
    ("fields", "status", "kind", "word"),
    [
        ({"garments": ["tube", "coat", "cape", "cloak"]}, 413, "TooLarge", "at most 3 layers"),
        ({"garments": ["tube", "hat"]}, 404, "NotFound", "hat"),
        ({"garments": []}, 400, "InputError", "garments"),
    ],
)
def test_outfits_that_make_no_sense_are_refused(client: httpx.Client, fields: dict, status: int, kind: str, word: str):
    response = ask(client, **fields)
    assert response.status_code == status
    problem = response.json()
    assert problem["type"] == f"urn:drape:{kind}" and word in problem["detail"]


def test_passes_that_the_model_does_not_have_are_refused(client: httpx.Client):
    response = ask(client, garment="tube", passes=2)
    assert response.status_code == 400 and "advanced.passes: expected 0 to 1" in response.json()["detail"]
    fewer, every, left_out = (ask(client, garment="tube", passes=passes) for passes in (0, 1, None))
    assert [one.headers["X-Drape-Passes"] for one in (fewer, every, left_out)] == ["0", "1", "1"]
    assert every.content == left_out.content != fewer.content
    assert "passes" in ask(client, garment="tube", passes=-1).json()["name"]


def test_a_stream_opens_an_outfit_and_turns_back_to_one_garment(outfit_url: str, client: httpx.Client, tube: Garment):
    count = tube.vertex_count
    expected = vertices_of(ask(client, garments=["tube", "coat"]))[0]
    with raw_stream(outfit_url) as stream:
        about = stream.open(garments=["tube", "coat"])
        assert about["garments"] == [{"id": "tube", "vertices": count}, {"id": "coat", "vertices": count}]
        assert about["vertices"] == 2 * count and "garment" not in about
        frame = stream.frame(1, POSES[0])
        assert np.abs(frame.vertices() - expected).max() < 1e-4 and frame.pushed
        about = stream.open(garment="tube")
        assert about["garment"] == "tube" and about["vertices"] == count and "garments" not in about
        assert len(stream.frame(2, POSES[0]).positions) == count


def test_a_stream_of_no_outfit_is_refused(outfit_url: str):
    with raw_stream(outfit_url) as stream:
        said = stream.open(garments=["tube", "tube"])
        assert said["type"] == "error" and said["kind"] == "InputError"


def test_an_outfit_is_its_layers_in_their_order(runtime: DrapeRuntime):
    scene = runtime.garments.scene(None, ["coat", "tube", "cape"])
    assert isinstance(scene, Outfit) and scene == runtime.garments.scene(None, ["coat", "tube", "cape"])
    assert scene != runtime.garments.scene(None, ["tube", "coat", "cape"])


def test_what_a_registry_refuses(runtime: DrapeRuntime):
    registry = runtime.garments
    with pytest.raises(InputError, match="both"):
        registry.scene("tube", ["coat"])
    with pytest.raises(InputError, match="a value"):
        registry.scene(None, None)
    with pytest.raises(TooLarge, match="3 layers"):
        registry.scene(None, ["tube", "coat", "cape", "cloak"])
    with pytest.raises(InputError, match="each garment once"):
        registry.scene(None, ["coat", "coat"])


def test_constants_of_outfits_are_kept_and_bounded(tiny_folder: Path, tube: Garment, monkeypatch):
    pusher = added(Pusher(Engine(tiny_folder / "models" / TINY), load_body()), tube, replace(tube, digest="b"))
    first = pusher._layer((tube.digest, "b"))
    pusher.prepare((tube.digest, "b"))
    assert pusher._layer((tube.digest, "b")) is first
    monkeypatch.setattr("drape.stages.collision.KEPT_OUTFITS", 1)
    pusher.prepare(("b", tube.digest))
    assert list(pusher._layers) == [("b", tube.digest)] and KEPT_OUTFITS > 1
    with pytest.raises(NotFound, match="hat"):
        pusher.prepare((tube.digest, "hat"))


HIDDEN_POSES, TRANS = smooth_motion(np.arange(3) / 30.0)
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
    return run(plan, [PoseInput(HIDDEN_POSES, TRANS, np.zeros(10), np.arange(3) / 30.0)])


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
    ("hidden", "options"),
    [
        (["tube"], {}), (["cape"], {}), (["coat"], {"push_out": False}), (["tube"], {"folds": 1}),
        (["tube", "cape"], {"folds": 1}), (["coat"], {"folds": 1, "cloth_contact": False}),
        (["coat"], {"folds": 1, "push_out": False}),
    ],
)  # fmt: skip
def test_visible_garments_are_to_the_bit_those_of_the_whole_outfit(
    runtime: DrapeRuntime, hidden: list[str], options: dict
):
    whole, less = draped(planned(runtime, **options)), draped(planned(runtime, hidden=hidden, **options))
    seen = [layer.vertices for layer, name in zip(whole.layers, WORN, strict=True) if name not in hidden]
    assert_array_equal(less.vertices, concatenated(seen))


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
    assert_allclose(less.quality.pushed_share, 2.0 * whole.quality.pushed_share - inner, rtol=0, atol=1e-12)


def test_steps_of_a_stream_hide_what_the_stream_hides(runtime: DrapeRuntime):
    plan = planned(runtime, hidden=["tube", "cape"], folds=4, messages=True)
    for step in runtime.steps(plan):
        assert step.shown == plan.shown and step.keys == plan.keys


def hidden_ask(url: str, **fields: object) -> httpx.Response:
    return httpx.post(f"{url}/drape", json={"poses": HIDDEN_POSES.tolist(), **fields}, timeout=60.0)


def test_answers_name_the_visible_garments(outfit_url: str, tube: Garment):
    whole, less = (
        hidden_ask(outfit_url, garments=["tube", "coat"]),
        hidden_ask(outfit_url, garments=["tube", "coat"], hidden=["tube"]),
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
    answer = hidden_ask(outfit_url, **fields)
    assert answer.status_code == 400 and word in answer.text


def test_garments_are_prepared_when_they_are_wanted_or_all_beside_frames(outfit_settings: Settings):
    clip = PoseInput(*random_motion(3, seed=5), np.zeros(10), np.arange(3) / 30.0)
    with closing(DrapeRuntime(outfit_settings, at_once=False)) as late, closing(DrapeRuntime(outfit_settings)) as early:
        entries = late.garments.entries()
        assert len(late.worn.missing(entries)) == len(entries)
        assert not early.worn.missing(early.garments.entries())
        found = [
            asyncio.run(one.drape(one.plan(one.garments.entries()[-1], DrapeOptions()), clip)) for one in (late, early)
        ]
        assert_array_equal(found[0].vertices, found[1].vertices)
        assert len(late.worn.missing(entries)) == len(entries) - 1
        asyncio.run(late.prepare_all())
        assert not late.worn.missing(entries)
