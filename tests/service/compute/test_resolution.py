"""Meshes that are delivered coarse: folds happen on the finer one, and clients choose which of the two comes."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from clients.cli import main
from clients.client import AsyncDrapeClient, DrapeClient
from drape.body.model import BodyModel
from drape.garment.cache import Garment, save_garment
from drape.garment.fine import SUFFIX, fine_garment
from drape.garment.wrapping import Wrapping
from drape.stages.batch import PoseInput
from drape.stages.scene import Outfit
from drape.stages.stage import carried
from drape.stages.walk import run
from drape.wire.options import Advanced, DrapeOptions
from service.app import create_app
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.garments import tube_garment
from tests.fixtures.poses import smooth_motion
from tests.fixtures.serving import serve
from tests.fixtures.streams import raw_stream

TIMES_S = np.arange(3) / 30.0
POSES, TRANS = smooth_motion(TIMES_S)
CLIP = PoseInput(POSES, TRANS, np.zeros(10), TIMES_S)
NEAR_M = 0.03


@pytest.fixture(scope="module")
def coarse(body: BodyModel) -> Garment:
    return tube_garment(body, name="coarse", radius_m=0.21, subdivided=True)


@pytest.fixture(scope="module")
def coarse_settings(make_settings, tube: Garment, coarse: Garment, tmp_path_factory) -> Settings:
    folder = tmp_path_factory.mktemp("coarse")
    save_garment(tube, folder)
    save_garment(coarse, folder)
    return make_settings(shipped_garments_dir=folder)


@pytest.fixture(scope="module")
def runtime(coarse_settings: Settings) -> Iterator[DrapeRuntime]:
    made = DrapeRuntime(coarse_settings)
    yield made
    made.close()


@pytest.fixture(scope="module")
def url(runtime: DrapeRuntime) -> Iterator[str]:
    with serve(create_app(runtime.settings, runtime=runtime), runtime.settings) as address:
        yield address


def draped(runtime: DrapeRuntime, **options: object) -> np.ndarray:
    plan = runtime.plan(runtime.garments.get("coarse"), DrapeOptions(**options))  # type: ignore[arg-type]
    return asyncio.run(runtime.drape(plan, CLIP)).vertices


def test_a_hidden_garment_is_wrapped_for_the_push_out_alone(runtime: DrapeRuntime, monkeypatch: pytest.MonkeyPatch):
    """Layers above feel its cloth; where they do not, they are pushed off it, and nobody else reads its mesh."""
    scene = runtime.garments.scene(None, ["coarse", "tube"])
    wrapped: list[int] = []
    wrap = Wrapping.wrap

    def noted(wrapping: Wrapping, cloth: np.ndarray) -> np.ndarray:
        wrapped.append(len(cloth))
        return wrap(wrapping, cloth)

    monkeypatch.setattr(Wrapping, "wrap", noted)
    for feels, frames in ((True, 0), (False, len(POSES))):
        whole, less = (
            runtime.plan(
                scene, DrapeOptions(advanced=Advanced(folds=1, push_out=True, cloth_contact=feels), hidden=hidden)
            )
            for hidden in (None, ("coarse",))
        )
        both = asyncio.run(runtime.drape(whole, CLIP)).vertices
        wrapped.clear()
        assert_array_equal(asyncio.run(runtime.drape(less, CLIP)).vertices, both[:, scene.layers[0].vertex_count :])
        assert len(wrapped) == frames


def test_without_folds_nothing_fine_is_computed_and_no_bit_changes(coarse_settings: Settings, coarse: Garment):
    runtime = DrapeRuntime(coarse_settings)
    held = runtime.device_bytes
    before = draped(runtime, folds=0)
    plan = runtime.plan(runtime.garments.get("coarse"), DrapeOptions(advanced=Advanced(folds=0)))
    assert plan.draped == plan.scene.layers and plan.draped_keys == plan.keys == (coarse.digest,)
    assert runtime.device_bytes == held and before.shape[1] == coarse.vertex_count
    assert draped(runtime, folds=1).shape == before.shape and runtime.device_bytes > held
    assert_array_equal(draped(runtime, folds=0), before)
    runtime.close()


def test_folds_of_a_coarse_garment_are_those_of_its_fine_mesh_wrapped(runtime: DrapeRuntime, coarse: Garment):
    plain = draped(runtime, folds=0, push_out=False)
    sent = draped(runtime, folds=2, push_out=False)
    fine = draped(runtime, folds=2, push_out=False, resolution="fine")
    assert fine.shape[1] == len(coarse.vertices) > coarse.vertex_count
    wrapping = Wrapping(coarse)
    assert_array_equal(sent, np.stack([wrapping.wrap(cloth) for cloth in fine]))
    assert 1e-5 < np.abs(sent - plain).max() < NEAR_M


def test_fine_without_folds_begins_with_the_delivered_drape(runtime: DrapeRuntime, coarse: Garment):
    fine = draped(runtime, push_out=False, folds=0, resolution="fine")
    assert np.abs(fine[:, : coarse.vertex_count] - draped(runtime, push_out=False, folds=0)).max() < 1e-5
    jets = runtime.plan(runtime.garments.get("coarse"), DrapeOptions(geometry="jets", resolution="fine"))
    assert jets.keys == (coarse.digest + SUFFIX,)


def test_a_garment_that_is_fine_enough_has_one_mesh(runtime: DrapeRuntime, tube: Garment):
    entry = runtime.garments.get("tube")
    for resolution in ("delivered", "fine"):
        plan = runtime.plan(entry, DrapeOptions(advanced=Advanced(folds=2), resolution=resolution))
        assert plan.scene is entry and plan.draped == (entry,) and plan.keys == (tube.digest,)
    outfit = runtime.garments.scene(None, ["tube", "coarse"])
    plan = runtime.plan(outfit, DrapeOptions(advanced=Advanced(folds=1)))
    again = runtime.plan(runtime.garments.scene(None, ["tube", "coarse"]), DrapeOptions(advanced=Advanced(folds=1)))
    assert plan == again and plan.scene == outfit and plan.draped == outfit.fine.layers
    assert plan.draped_keys == (tube.digest, plan.keys[1] + SUFFIX)


def test_folds_are_remembered_across_resolutions(runtime: DrapeRuntime):
    entry = runtime.garments.get("coarse")
    delivered, fine = (
        runtime.plan(entry, DrapeOptions(advanced=Advanced(folds=1), resolution=name)) for name in ("delivered", "fine")
    )
    asyncio.run(runtime.prepare(delivered))
    memories = run(delivered, [CLIP]).memories[0]
    assert memories.keys() == {("folds", fine.keys[0])}
    assert carried(memories, delivered, fine) == memories == carried(memories, fine, delivered)
    assert not carried(memories, delivered, runtime.plan(entry, DrapeOptions(advanced=Advanced(folds=0))))


def test_clients_get_the_mesh_that_a_drape_has(url: str, coarse: Garment):
    fine = fine_garment(coarse)
    with DrapeClient(url) as client:
        info = {entry["id"]: entry for entry in client.garments()}
        assert (info["coarse"]["vertices"], info["coarse"]["fine_vertices"]) == (216, len(coarse.vertices))
        assert info["tube"]["vertices"] == info["tube"]["fine_vertices"]
        delivered, document = client.mesh("coarse"), client.mesh("coarse", "fine")
        assert_array_equal(np.array(delivered["faces"]), coarse.faces)
        assert_array_equal(np.array(document["faces"]), fine.faces)
        assert_array_equal(np.array(document["uv"], np.float32), fine.uv)
        assert_array_equal(np.array(document["uv_faces"]), fine.uv_faces)
        assert_array_equal(np.array(document["face_material"]), fine.face_material)
        vertices = client.drape("coarse", POSES, trans=TRANS, folds=1, resolution="fine")
        assert vertices.shape == (3, len(document["vertices"]), 3)
        outfit = client.drape_outfit(["tube", "coarse"], POSES, trans=TRANS, resolution="fine")
        assert [layer.shape[1] for layer in outfit] == [216, fine.vertex_count]
        layout = client.jet_layout("coarse", "fine")
        frame = client.drape_jets("coarse", POSES, trans=TRANS, resolution="fine")[0]
        assert layout.vertices(frame).shape == (fine.vertex_count, 3)
        glb = client.drape_glb("coarse", POSES[:1], resolution="fine")

    async def awaited() -> tuple[dict, int]:
        async with AsyncDrapeClient(url) as client:
            return await client.mesh("coarse", "fine"), len((await client.jet_layout("coarse", "fine")).rest)

    assert asyncio.run(awaited()) == (document, fine.vertex_count)
    described = json.loads(glb[20 : 20 + int.from_bytes(glb[12:16], "little")])
    corners = sum(described["accessors"][part["indices"]]["count"] for part in described["meshes"][0]["primitives"])
    assert corners == 3 * len(fine.faces)


def test_other_resolutions_are_refused(url: str):
    document = {"garment": "coarse", "poses": POSES[:1].tolist(), "resolution": "finest"}
    assert httpx.post(url + "/drape", json=document).json()["name"] == "resolution"
    for what in ("mesh", "jets"):
        refused = httpx.get(url + f"/garments/coarse/{what}?resolution=finest")
        assert refused.is_client_error and refused.json()["name"] == "resolution"


def test_streams_say_and_send_the_mesh_that_was_asked_for(url: str, coarse: Garment):
    with raw_stream(url) as stream:
        for resolution, count in (("fine", len(coarse.vertices)), ("delivered", coarse.vertex_count)):
            opened = stream.open(garment="coarse", folds=1, resolution=resolution)
            assert opened["vertices"] == count and opened.get("resolution", "delivered") == resolution
            assert ("resolution" in opened) == (resolution == "fine"), "an answer of before stays as it was"
            assert len(stream.frame(1, POSES[0]).positions) == count


def test_the_command_line_has_it(url: str, coarse: Garment, tmp_path: Path):
    out = tmp_path / "out.npy"
    base = ["drape", "--url", url, "--garment", "coarse", "--motion", "walk", "--fps", "2", "--out", str(out)]
    assert main([*base, "--resolution", "fine"]) == 0
    assert np.load(out).shape[1] == len(coarse.vertices)
    with pytest.raises(SystemExit):
        main([*base, "--resolution", "finest"])


def test_a_hidden_garment_over_a_coarse_one_leaves_the_push_out_what_it_needs(coarse_settings: Settings):
    own = DrapeRuntime(coarse_settings, at_once=False)
    scene = Outfit((own.garments.get("coarse"), own.garments.get("tube")))
    whole = DrapeOptions(advanced=Advanced(folds=2, cloth_contact=False))
    hidden, both = (own.plan(scene, options) for options in (whole.updated(hidden=("tube",)), whole))
    assert len(hidden.scene.layers) == 1 and "collision" in [stage.name for stage in hidden.stages]
    alone, outfit = (asyncio.run(own.drape(plan, CLIP)) for plan in (hidden, both))
    own.close()
    assert_array_equal(alone.vertices, outfit.layers[0].vertices)
