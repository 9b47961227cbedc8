"""Jets over stream and REST: the vertices of the same pose within a tolerance, old clients as before, refusals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from websockets.exceptions import ConnectionClosed

from drape.body.model import BodyModel
from drape.contact.projection import CLEARANCE_M, blend_displacement, push_in_parts
from drape.contact.skin import body_skin, posed_table
from drape.errors import TooLarge
from drape.garment.cache import Garment
from drape.graph.feeds import garment_feed
from drape.graph.push_feed import pack_push
from drape.motion.hard_poses import hard_poses
from drape.motion.samples import SAMPLES
from drape.stages.batch import PoseInput
from drape.stages.walk import run
from drape.wire import messages as wire
from drape.wire.jets import JetFrame, message_bytes, pack_jets, split_jets, unpack_jets
from drape.wire.layout import JetLayout, unpack_layout
from drape.wire.options import Advanced, DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.guard.key_file import ANYONE
from service.http.answers import BINARY, GLB, JSON
from service.http.clip_jobs import RequestedClip
from service.http.clip_routes import check_clip_size
from service.http.schemas import ClipOptions
from tests.fixtures.garments import ship
from tests.fixtures.layers import through_pct
from tests.fixtures.patience import PATIENT_S
from tests.fixtures.poses import random_motion
from tests.fixtures.serving import vertices_of
from tests.fixtures.streams import RawStream, raw_stream

QUANTISED_M = 1e-4  # at the 99th percentile
POSES, TRANS = random_motion(3, spread_rad=0.5)


@pytest.fixture(scope="module")
def layout(client: httpx.Client) -> JetLayout:
    return unpack_layout(client.get("/garments/tube/jets").content)


def ask(client: httpx.Client, accept: str | None = BINARY, **fields: object) -> httpx.Response:
    document = {"poses": POSES.tolist(), "trans": TRANS.tolist(), **fields}
    return client.post("/drape", json=document, headers={} if accept is None else {"Accept": accept})


def jets_of(response: httpx.Response) -> list[JetFrame]:
    assert response.status_code == 200, response.text
    assert response.headers["content-type"] == BINARY
    return split_jets(response.content)


def test_the_layout_is_the_garment(client: httpx.Client, tube: Garment, layout: JetLayout):
    response = client.get("/garments/tube/jets", headers={"Accept": BINARY})
    assert response.headers["X-Drape-Vertices"] == "216" and response.headers["X-Drape-Patches"] == "12"
    assert_array_equal(layout.chart_patch, tube.chart_patch)
    assert_array_equal(layout.rest, tube.vertices)


def test_a_clip_of_jets_is_the_clip_of_vertices(client: httpx.Client, layout: JetLayout):
    betas = [0.5] * 10
    response = ask(client, None, garment="tube", betas=betas, push_out=False, geometry="jets", fps=10.0)
    frames = jets_of(response)
    expected = vertices_of(ask(client, garment="tube", betas=betas, push_out=False, geometry="vertices"))
    assert response.headers["X-Drape-Frames"] == "3" and response.headers["X-Drape-Patches"] == "12"
    assert response.headers["X-Drape-Left-M"] == "0.000000" and response.headers["X-Drape-Push-Out"] == "0"
    assert [frame.sequence for frame in frames] == [0, 1, 2]
    assert_allclose([frame.client_time_s for frame in frames], [0.0, 0.1, 0.2])
    got = np.stack([layout.vertices(frame) for frame in frames])
    assert np.abs(got - expected).max() < QUANTISED_M
    assert len(response.content) == 3 * message_bytes(12)


def test_pushed_jets_are_the_drape_and_what_charts_carry(body: BodyModel, tube: Garment, client: httpx.Client):
    """By the formula of the push-out, on the vertices of the drape."""
    response = ask(client, garment="tube", geometry="jets")
    frames = jets_of(response)
    bare = vertices_of(ask(client, garment="tube", push_out=False))
    layout = unpack_layout(client.get("/garments/tube/jets").content)
    feed = pack_push(garment_feed(tube), tube.vertices, body_skin(body))
    skin, furthest = posed_table(body, POSES, np.zeros(10)), []
    for i, frame in enumerate(frames):
        drape = (bare[i] - frame.root)[None].astype(np.float32)
        parts = push_in_parts(drape, skin[i : i + 1], feed, CLEARANCE_M)
        carried = blend_displacement(parts.coefficients, feed)[0].T[feed.vertex_slot]
        furthest.append(np.abs(carried).max())
        assert np.linalg.norm(layout.positions(frame) - drape[0] - carried, axis=1).max() < 2.0 * QUANTISED_M
        assert frame.left_m == pytest.approx(float(parts.left_m[0]), abs=2e-5)
        assert frame.pushed and 0.0 < frame.pushed_share < 1.0 and 0.0 < frame.left_m < frame.push_max_m
    assert max(furthest) > 0.005, "must push for the test to mean something"
    assert float(response.headers["X-Drape-Left-M"]) == pytest.approx(max(f.left_m for f in frames), abs=1e-6)


def test_an_outfit_of_jets_parts_into_its_garments(client: httpx.Client, tube: Garment):
    response = ask(client, garments=["tube", "coat"], geometry="jets")
    assert response.headers["X-Drape-Garments"] == "tube:12,coat:12"
    layouts = [unpack_layout(client.get(f"/garments/{name}/jets").content) for name in ("tube", "coat")]
    alone = jets_of(ask(client, garment="tube", geometry="jets"))
    faces = tube.faces.astype(np.int64)
    bare = vertices_of(ask(client, garments=["tube", "coat"], push_out=False)).astype(np.float64)
    for i, frame in enumerate(jets_of(response)):
        parts = frame.layers([layout.patch_count for layout in layouts])
        inner, outer = (layout.vertices(part)[None] for layout, part in zip(layouts, parts, strict=True))
        assert np.abs(inner[0] - layouts[0].vertices(alone[i])).max() < 2.0 * QUANTISED_M
        before = through_pct(bare[i : i + 1, 216:], bare[i : i + 1, :216], faces)
        assert before.min() > 10.0, "must be through for the test to mean something"
        assert through_pct(outer, inner, faces).max() < 0.5 * before.min()


@pytest.mark.parametrize(
    ("accept", "fields", "status", "word"),
    [
        (GLB, {"geometry": "jets"}, 406, "expected one of application/octet-stream"),
        (JSON, {"geometry": "jets"}, 406, "expected one of application/octet-stream"),
        (BINARY, {"geometry": "steps"}, 400, "geometry"),
        (BINARY, {"geometry": None}, 400, "geometry"),
    ],
)
def test_what_jets_cannot_be_is_refused(client: httpx.Client, accept: str, fields: dict, status: int, word: str):
    response = ask(client, accept, garment="tube", **fields)
    assert response.status_code == status
    problem = response.json()
    assert word in problem["detail"] and problem["expected"] and problem["got"] and problem["cure"]


def test_layouts_of_no_garment_and_in_no_format_are_refused(client: httpx.Client):
    assert client.get("/garments/hat/jets").status_code == 404
    assert client.get("/garments/tube/jets", headers={"Accept": JSON}).status_code == 406


def message_of(stream: RawStream, sequence: int) -> bytes:
    return stream.message(sequence, POSES[0], TRANS[0], time_s=2.5)


def test_a_stream_turns_from_vertices_to_jets_and_back(outfit_url: str, layout: JetLayout, client: httpx.Client):
    expected = layout.vertices(jets_of(ask(client, garment="tube", geometry="jets"))[0])
    with raw_stream(outfit_url) as stream:
        plain = stream.open(garment="tube")
        old = {"type", "garment", "vertices", "model", "body", "credit", "push_out", "motion"}
        old |= {"tier", "passes", "folds", "safe_folds", "bits"}
        assert set(plain) == old, "what is said of jets is not said of vertices"
        frame = wire.unpack_frame(message_of(stream, 1))
        about = stream.open(garment="tube", geometry="jets")
        assert set(about) == old | {"geometry", "patches"}
        assert (about["geometry"], about["patches"], about["vertices"]) == ("jets", 12, 216)
        message = message_of(stream, 2)
        jets = unpack_jets(message)
        assert (jets.sequence, jets.client_time_s, jets.dropped, jets.pushed) == (2, 2.5, 0, True)
        assert 0 < jets.residence_us < 5e6
        assert np.abs(layout.vertices(jets) - expected).max() < QUANTISED_M
        outfit = stream.open(garments=["tube", "coat"], geometry="jets")
        assert outfit["patches"] == 24 and [worn["patches"] for worn in outfit["garments"]] == [12, 12]
        assert len(unpack_jets(message_of(stream, 3)).jet) == 24
        assert "patches" not in stream.open(garments=["tube", "coat"])["garments"][0]
        stream.open(garment="tube")
        assert_array_equal(wire.unpack_frame(message_of(stream, 4)).positions, frame.positions)


def test_a_stream_of_another_geometry_is_refused(outfit_url: str):
    with raw_stream(outfit_url) as stream:
        said = stream.open(garment="tube", geometry="splats")
        assert said["type"] == "error" and said["name"] == "geometry" and "'vertices' or 'jets'" in said["expected"]
        with pytest.raises(ConnectionClosed) as closed:
            stream.socket.recv(timeout=PATIENT_S)
        assert closed.value.rcvd is not None and closed.value.rcvd.code == 4400


def test_an_answer_of_jets_has_the_same_limit(make_runtime: Callable[..., DrapeRuntime]):
    runtime = make_runtime(max_answer_bytes=10 * message_bytes(12))
    entry = runtime.garments.get("tube")

    def check(frames: int) -> None:
        asked = ClipOptions(garment="tube", geometry="jets")
        plan, zeros = runtime.plan(entry, asked, messages=True), np.zeros((frames, 3))
        clip = PoseInput(np.zeros((frames, 24, 3)), zeros, np.zeros(10), np.zeros(frames))
        check_clip_size(RequestedClip(plan, clip, asked, ANYONE), BINARY, runtime.settings)

    check(10)
    with pytest.raises(TooLarge, match="11 frames of 12 patches"):
        check(11)
    object.__setattr__(entry, "garment", replace(entry.garment, patch_centre=np.zeros((65537, 3))))
    with pytest.raises(TooLarge, match="tube patches: expected at most 65536"):
        _ = entry.jet_layout


@pytest.fixture(scope="module")
def shipped(make_runtime: Callable[..., DrapeRuntime], tmp_path_factory) -> DrapeRuntime:
    """The shipped model with two of its garments."""
    folder = ship(tmp_path_factory.mktemp("two"), "tank", "shorts")
    return make_runtime(model="onefit", shipped_garments_dir=folder)


@pytest.mark.slow
def test_of_the_shipped_model_hard_poses_come_within_a_tenth_of_a_millimetre(shipped: DrapeRuntime):
    poses = hard_poses([make() for make in SAMPLES.values()], shipped.body, 3).poses
    trans, betas, held = np.zeros((len(poses), 3)), np.zeros(10), []
    for name in ("tank", "shorts"):
        entry = shipped.garments.get(name)
        layout = unpack_layout(entry.jet_layout)
        clip = PoseInput(poses, trans, betas, trans[:, 0])
        asked = [
            DrapeOptions(advanced=Advanced(push_out=True), geometry="jets"),
            DrapeOptions(advanced=Advanced(push_out=True)),
            DrapeOptions(advanced=Advanced(push_out=False), geometry="jets"),
        ]
        draped = [run(shipped.plan(entry, options), [clip]) for options in asked]
        jets, bare, vertices = draped[0].jets, draped[2].jets, draped[1].vertices
        left_m, push_max_m = draped[0].quality.left_m, draped[0].quality.push_max_m
        assert_array_equal(push_max_m, draped[1].quality.push_max_m)
        for row in range(len(poses)):
            posed = {"jet": jets.jet[row], "rotation": jets.rotation[row], "centre": jets.centre[row]}
            exact = JetFrame(0, 0.0, 0.0, draped[0].root[row], **posed)
            sent = unpack_jets(pack_jets(exact))
            rounding = np.linalg.norm(layout.positions(sent) - layout.positions(exact), axis=1)
            assert np.percentile(rounding, 99) < QUANTISED_M and rounding.max() < 3.0 * QUANTISED_M
            gap = np.linalg.norm(layout.positions(sent) - vertices[row], axis=1)
            # Where the body pushes, jets carry what they can: a millimetre or so is left of a push of up to five.
            assert np.median(gap) < QUANTISED_M and np.percentile(gap, 99) < 0.5 * max(4e-3, push_max_m[row])
            assert left_m[row] <= push_max_m[row]
        assert_array_equal(bare.rotation, jets.rotation)
        assert (draped[2].quality.left_m == 0.0).all()
        held.append(np.abs(jets.jet - bare.jet).max())
    assert max(held) > 0.01, "must push for the test to mean something"
