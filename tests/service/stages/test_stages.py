"""The way of a frame: which stages a plan takes and what it leaves out, memories, and poses unlike training."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape import stages
from drape.errors import InputError
from drape.inference.engine import Engine
from drape.inference.graph_names import JETS, PACKED
from drape.stages.batch import Batch, Layer, PoseInput
from drape.stages.encode import coordinate_bits
from drape.stages.motion import Motion
from drape.stages.plan import Plan
from drape.stages.stage import BODY, Stage, carried
from drape.stages.tiers import FAR_PIXELS_PER_M, TIERS, capped, chosen
from drape.stages.walk import run
from drape.wire import messages as wire
from drape.wire.jets import unpack_jets
from drape.wire.options import Advanced, DrapeOptions
from service.app import create_app
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.poses import smooth_motion
from tests.fixtures.serving import serve, served
from tests.fixtures.streams import RawStream, raw_stream
from tests.fixtures.tiny_model import TINY, TINY_DYNAMIC, write_tiny_model
from training.pose_support import support_of, write_support

TIMES_S = np.arange(10) / 30.0
POSES, TRANS = smooth_motion(TIMES_S)
CLIP = PoseInput(POSES, TRANS, np.zeros(10), TIMES_S)
STEP_M = 0.01


class Counting(Stage):
    """Lifts each garment by a centimetre per frame that it has been worn: the smallest stage with a memory."""

    name = "counting"

    def needs(self, plan: Plan) -> frozenset[str]:
        return frozenset({"vertices"})

    def depends_on(self, plan: Plan) -> object:
        return plan.options.advanced.passes

    def run(self, batch: Batch) -> Batch:
        for i, (key, layer) in enumerate(zip(batch.plan.keys, batch.layers, strict=True)):
            assert layer.vertices is not None
            before = [memory or 0 for memory in batch.remembered((self.name, key))]
            worn = [n + np.arange(1, len(one.poses) + 1) for n, one in zip(before, batch.inputs, strict=True)]
            lift = np.float32(STEP_M) * np.concatenate(worn)[:, None, None] * np.array([0.0, 1.0, 0.0], np.float32)
            lifted = Layer(layer.vertices + lift, layer.jets)
            batch = replace(batch, layers=(*batch.layers[:i], lifted, *batch.layers[i + 1 :]))
            batch = batch.remember((self.name, key), [int(count[-1]) for count in worn])
        return batch


@pytest.fixture
def counting(monkeypatch: pytest.MonkeyPatch) -> None:
    """The line in ``STAGES``."""
    *first, last = stages.STAGES
    monkeypatch.setattr(stages, "STAGES", (*first, Counting, last))


@pytest.fixture(scope="module")
def runtime(make_runtime: Callable[..., DrapeRuntime]) -> DrapeRuntime:
    return make_runtime(model=TINY_DYNAMIC)


# --- plans ---


@pytest.mark.parametrize(
    ("options", "messages", "taken", "needs"),
    [
        ({}, False, ["motion", "network", "collision"], {"vertices", "skin"}),
        ({"inertia": "mesh"}, False, ["network", "swing", "collision"], {"vertices", "skin"}),
        ({"push_out": False, "motion": 0.0}, False, ["network"], {"vertices"}),
        ({"push_out": False, "motion": 0.0, "inertia": "mesh"}, False, ["network"], {"vertices"}),
        ({"push_out": False, "motion": 0.0, "geometry": "jets"}, True, ["network", "encode"], {"jets"}),
        ({"motion": 0.0, "geometry": "jets"}, False, ["network", "collision"], {"jets", "vertices", "skin"}),
    ],
)
def test_a_plan_takes_what_it_needs_and_nothing_else(
    runtime: DrapeRuntime, options: dict, messages: bool, taken: list[str], needs: set[str]
):
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions(**options), messages=messages)
    assert [stage.name for stage in plan.stages] == taken and plan.needs == needs
    ran: list[str] = []

    class Heard:
        """A stage that says when it runs."""

        def __init__(self, stage: Stage) -> None:
            self.stage, self.name = stage, stage.name

        def steps(self, batch: Batch) -> Iterator[Batch]:
            ran.append(self.stage.name)
            return self.stage.steps(batch)

    batch = run(replace(plan, stages=tuple(Heard(stage) for stage in plan.stages)), [CLIP])  # type: ignore[misc]
    assert ran == taken
    assert (batch.skin is not None) == ("skin" in needs) and len(batch.messages) == (len(POSES) if messages else 0)
    assert (batch.layers[0].jets is None) == ("jets" not in needs)
    assert (batch.layers[0].vertices is None) == ("vertices" not in needs)


@pytest.mark.parametrize(
    ("worn", "options"),
    [
        (["tube", "coat"], {}),
        (["tube"], {"push_out": False}),
        (["tube"], {"geometry": "jets"}),
        (["tube"], {"passes": 0}),
    ],
)
def test_frames_open_no_session_once_their_plan_is_prepared(outfit_settings: Settings, worn: list[str], options: dict):
    runtime = DrapeRuntime(outfit_settings)
    plan = runtime.plan(runtime.garments.scene(None, worn), DrapeOptions(**options), messages=True)
    asyncio.run(runtime.prepare(plan))
    opened = set(runtime.engine._opened)
    one, other = CLIP.part(slice(0, 1), {}), replace(CLIP.part(slice(1, 2), {}), betas=np.ones(10))
    for inputs in ([one], [CLIP], [one, other]):
        run(plan, inputs)
    assert set(runtime.engine._opened) == opened
    runtime.close()


def test_the_network_computes_no_vertex_for_jets_alone(make_settings: Callable[..., Settings]):
    settings = make_settings()
    graph = Engine(Path(settings.model), compiled=False)
    runtime = DrapeRuntime(settings, engine=graph)
    run(
        runtime.plan(runtime.garments.get("tube"), DrapeOptions(advanced=Advanced(push_out=False), geometry="jets")),
        [CLIP],
    )
    (part,) = [s for (graph, outputs, *_), s in runtime.engine._opened.items() if (graph, outputs) == (PACKED, JETS)]
    assert "patch_first" in part.inputs
    assert not {"tile_positions", "vertex_charts", "tile_tangents"} & set(part.inputs)
    runtime.close()


def test_what_is_left_open_is_the_services_own(runtime: DrapeRuntime, make_runtime: Callable[..., DrapeRuntime]):
    entry = runtime.garments.get("tube")
    assert runtime.plan(entry, DrapeOptions()).options == DrapeOptions(
        advanced=Advanced(push_out=True, inertia="network", folds=0, coarse=False), motion=1.0
    )
    other = make_runtime()
    entry = other.garments.get("tube")
    plan, every = (other.plan(entry, DrapeOptions(advanced=Advanced(passes=passes))) for passes in (None, 1))
    still = DrapeOptions(advanced=Advanced(push_out=True, inertia="network", folds=0, coarse=False), motion=0.0)
    assert plan.options == still, "a static model has learned no motion"
    assert plan == every and hash(plan) == hash(every), "all passes are the default"
    assert plan != other.plan(entry, DrapeOptions(advanced=Advanced(passes=0)))
    assert make_runtime(inertia="mesh").plan(entry, DrapeOptions()).options == still.updated(knob=1.0, inertia="mesh")
    with pytest.raises(InputError, match=r"^advanced\.passes: expected 0 to 1, got 9"):
        other.plan(entry, DrapeOptions(advanced=Advanced(passes=9)))


def test_memories_go_where_what_they_hold_for_goes(counting: None, make_runtime: Callable[..., DrapeRuntime]):
    runtime = make_runtime(model=TINY_DYNAMIC)
    entry = runtime.garments.get("tube")
    plan = runtime.plan(entry, DrapeOptions())
    own = ("counting", entry.garment.digest)
    memories = {Motion.key: 1, own: 2, ("counting", "taken off"): 3}
    assert Motion.key == ("motion", BODY)
    assert carried(memories, plan, plan) == {Motion.key: 1, own: 2}
    assert carried(memories, plan, runtime.plan(entry, DrapeOptions(advanced=Advanced(push_out=False)))) == {
        Motion.key: 1,
        own: 2,
    }
    assert carried(memories, plan, runtime.plan(entry, DrapeOptions(advanced=Advanced(passes=0)))) == {Motion.key: 1}
    assert carried(memories, plan, runtime.plan(entry, DrapeOptions(motion=0.0))) == {own: 2}


# --- a stage of one's own ---


def lifts(frames: np.ndarray, plain: np.ndarray) -> np.ndarray:
    """How far [cm] each frame's vertices (F, V, 3) lie above those without the stage."""
    return (frames - plain)[..., 1].mean(axis=1) / STEP_M


@pytest.mark.usefixtures("counting")
def test_a_new_stage_remembers_over_the_chunks_of_a_clip(outfit_settings: Settings):
    runtime = DrapeRuntime(outfit_settings.model_copy(update={"chunk_frames": 4}))
    scene = runtime.garments.scene(None, ["tube", "coat"])
    plan = runtime.plan(scene, DrapeOptions(advanced=Advanced(push_out=False)))
    assert [stage.name for stage in plan.stages] == ["network", "counting"]
    plain = run(replace(plan, stages=plan.stages[:1]), [CLIP]).vertices
    whole = run(plan, [CLIP]).vertices
    assert_allclose(lifts(whole, plain), np.arange(1, 11), rtol=1e-3)
    chunked = asyncio.run(runtime.drape(plan, CLIP))
    assert_array_equal(chunked.vertices, whole)
    assert chunked.memories == ({("counting", entry.garment.digest): 10 for entry in scene.layers},)
    runtime.close()


@pytest.mark.usefixtures("counting")
def test_a_new_stage_remembers_per_stream_and_garment(outfit_settings: Settings):
    with served(outfit_settings) as url:
        document = {"garment": "tube", "poses": POSES[:1].tolist(), "push_out": False}
        answer = httpx.post(url + "/drape", json=document)
        first = np.frombuffer(answer.content, "<f4").reshape(-1, 3)[:, 1].mean()
        with raw_stream(url) as one, raw_stream(url) as two:

            def opened(stream: RawStream, *garments: str) -> None:
                assert stream.open(garments=garments, push_out=False)["type"] == "opened"

            def lift(stream: RawStream, sequence: int, vertices: slice) -> int:
                frame = stream.frame(sequence, POSES[0], time_s=sequence / 30.0)
                return round((frame.vertices()[vertices, 1].mean() - first) / STEP_M) + 1

            tube = slice(0, 216)
            for stream in (one, two):
                opened(stream, "tube")
            assert [lift(one, i, tube) for i in range(3)] == [1, 2, 3]
            assert lift(two, 0, tube) == 1, "another stream has a memory of its own"
            opened(one, "tube", "coat")
            assert lift(one, 4, tube) == 4, "what is worn on is remembered"
            opened(one, "coat")
            opened(one, "tube")
            assert lift(one, 5, tube) == 1, "what was taken off is forgotten"


SEEN = smooth_motion(np.arange(60) / 30.0)[0]
ABSURD = np.random.default_rng(0).uniform(-2.0, 2.0, (1, 24, 3))
MIXED = np.concatenate([SEEN[:2], ABSURD, SEEN[2:3]])


@pytest.fixture(scope="module")
def novelty_runtime(make_runtime: Callable[..., DrapeRuntime], body, tmp_path_factory) -> DrapeRuntime:
    """Of a model that knows its poses."""
    folder = tmp_path_factory.mktemp("novelty")
    write_support(write_tiny_model(folder, body), support_of(SEEN, SEEN))
    return make_runtime(model=str(folder / TINY), folds=None)


def draped(novelty_runtime: DrapeRuntime, poses: np.ndarray, **options: object) -> Batch:
    asked = DrapeOptions.model_validate({"settle": 1} | options)
    plan = novelty_runtime.plan(novelty_runtime.garments.get("tube"), asked, messages=True)
    for stage in plan.stages:
        stage.prepare(plan)
    return run(plan, [PoseInput(poses, np.zeros((len(poses), 3)), np.zeros(10), np.arange(len(poses)) / 30.0)])


@pytest.mark.parametrize(
    ("asked", "want"),
    [
        ({}, (2, 4)),
        ({"tier": "fast"}, (1, 4)),
        ({"tier": "accurate"}, (4, 4)),
        ({"folds": 2}, (2, 2)),
        ({"folds": 3, "safe_folds": 9}, (3, 9)),
        ({"folds": 3, "safe_folds": 0}, (3, 3)),
        ({"folds": 0, "safe_folds": 9}, (0, 0)),
        ({"geometry": "jets"}, (0, 0)),
    ],
)
def test_steps_of_unlike_poses_are_the_last_tiers_where_the_service_chooses(asked: dict, want: tuple):
    found = chosen(DrapeOptions(**asked), TIERS, Settings(), 4)
    assert (found.advanced.folds, found.advanced.safe_folds) == want


def test_under_load_a_lower_tier_holds_safe_steps_too():
    asked = chosen(DrapeOptions(), TIERS, Settings(), 4)
    assert [capped(asked, tier).advanced.safe_folds for tier in TIERS] == [0, 1, 4, 4]


def test_only_the_frame_unlike_training_gets_more_steps(novelty_runtime: DrapeRuntime):
    mixed, plain = draped(novelty_runtime, MIXED), draped(novelty_runtime, MIXED, safe_folds=0)
    assert (mixed.quality.novelty > 1.0).tolist() == [False, False, True, False]
    assert_array_equal(mixed.vertices[:2], plain.vertices[:2])
    assert np.abs(mixed.vertices[2] - plain.vertices[2]).max() > 0.0
    all_safe = draped(novelty_runtime, ABSURD, folds=4)
    assert_array_equal(draped(novelty_runtime, ABSURD).vertices, all_safe.vertices)


def test_messages_tell_the_score_and_whether_it_is_beyond(novelty_runtime: DrapeRuntime):
    batch = draped(novelty_runtime, MIXED)
    for frame, message in enumerate(batch.messages):
        novelty, flags = batch.quality.novelty[frame], message[6]
        assert bool(flags & wire.FLAG_UNLIKE) == (frame == 2)
        assert abs(wire.unpack_frame(message).novelty - min(novelty, 255 / 32)) <= 0.5 / 32
    (jets,) = draped(novelty_runtime, ABSURD, geometry="jets").messages
    assert unpack_jets(jets).novelty > 1.0


def test_a_clip_and_a_model_without_poses_say_so_in_headers(
    novelty_runtime: DrapeRuntime, make_runtime: Callable[..., DrapeRuntime]
):
    asked = {"garment": "tube", "poses": MIXED.tolist()}
    with serve(create_app(novelty_runtime.settings, runtime=novelty_runtime), novelty_runtime.settings) as url:
        headers = httpx.post(url + "/drape", json=asked).headers
    assert float(headers["X-Drape-Novelty"]) > 1.0
    assert (headers["X-Drape-Unlike"], headers["X-Drape-Safe-Folds"], headers["X-Drape-Folds"]) == ("1", "4", "2")
    plain = make_runtime(folds=None)
    assert plain.plan(plain.garments.get("tube"), DrapeOptions()).stages[0].name == "network"
    assert draped(plain, ABSURD).quality.novelty.tolist() == [0.0]


FAR = 0.5 * FAR_PIXELS_PER_M
VIEWS_POSES, VIEWS_TRANS = smooth_motion(np.arange(3) / 30.0)


@pytest.fixture
def views_runtime(make_runtime: Callable[..., DrapeRuntime]) -> DrapeRuntime:
    """Anew for each test, so that what it opened is what the test asked for."""
    return make_runtime(model=TINY_DYNAMIC, folds=None)


def views_draped(views_runtime: DrapeRuntime, **options: object) -> Batch:
    plan = views_runtime.plan(views_runtime.garments.get("tube"), DrapeOptions.model_validate(options), messages=True)
    for stage in plan.stages:
        stage.prepare(plan)
    return run(plan, [PoseInput(VIEWS_POSES, VIEWS_TRANS, np.zeros(10), np.arange(3) / 30.0)])


@pytest.mark.parametrize(
    ("asked", "want"),
    [
        ({}, (2, 0, 16)),
        ({"pixels_per_m": FAR}, (0, 0, 8)),
        ({"pixels_per_m": 0.1 * FAR, "tier": "accurate"}, (0, 0, 8)),
        ({"pixels_per_m": FAR, "folds": 1}, (1, 0, 8)),
        ({"pixels_per_m": FAR, "passes": 2}, (0, 2, 8)),
        ({"pixels_per_m": FAR_PIXELS_PER_M}, (2, 0, 16)),
        ({"pixels_per_m": FAR, "geometry": "jets"}, (0, 0, 16)),
    ],
)
def test_what_is_far_away_has_no_folds_and_8_bits_but_for_what_is_named(asked: dict, want: tuple):
    found = chosen(DrapeOptions(**asked), TIERS, Settings(), 4)
    assert (found.advanced.folds, found.advanced.passes, coordinate_bits(found)) == want
    assert found.pixels_per_m in (None, FAR_PIXELS_PER_M), "distances on one side of the limit are one plan"


def test_what_is_far_away_is_lifted_off_the_skin_as_the_least_tier_is():
    def found(**asked: object) -> DrapeOptions:
        return chosen(DrapeOptions.model_validate(asked), TIERS, Settings(), 4)

    assert found(pixels_per_m=FAR).advanced.coarse and found(pixels_per_m=FAR, tier="accurate").advanced.coarse
    for named in ({"push_out": False}, {"folds": 0}, {"geometry": "jets"}, {"coarse": False}):
        assert not found(pixels_per_m=FAR, **named).advanced.coarse
    assert found(pixels_per_m=FAR) == found(tier="instant").model_copy(update={"pixels_per_m": FAR_PIXELS_PER_M})


def test_what_is_far_away_heeds_no_number_of_the_service_and_refuses_passes_that_the_model_lacks(
    views_runtime: DrapeRuntime,
):
    far = DrapeOptions(pixels_per_m=FAR)
    assert chosen(far, TIERS, Settings(folds=2), 4) == chosen(far, TIERS, Settings(), 4)
    tube = views_runtime.garments.get("tube")
    with pytest.raises(InputError, match=r"advanced.passes"):
        views_runtime.plan(tube, far.updated(passes=views_runtime.engine.pass_count + 1))


def test_frames_of_8_bits_are_those_of_16_to_half_a_step_at_half_the_bytes(views_runtime: DrapeRuntime):
    near, far = (views_draped(views_runtime, folds=0, passes=0, **view) for view in ({}, {"pixels_per_m": FAR}))
    assert_array_equal(near.vertices, far.vertices)
    for fine, coarse, vertices in zip(near.messages, far.messages, far.vertices, strict=True):
        frame = wire.unpack_frame(coarse)
        assert (np.abs(frame.positions - vertices) <= 0.501 * frame.box_step).all()
        payload = len(fine) - wire.FRAME_HEADER_BYTES
        assert frame.bits == 8 and len(coarse) - wire.FRAME_HEADER_BYTES == payload / 2
