"""Uploads become garments or refusals; strangers' files never reach the serving process."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest

from clients.client import DrapeClient
from drape.garment.cache import Garment, save_garment
from service.compute.drape_runtime import DrapeRuntime
from service.compute.threads import SlicedThread
from service.guard.access import Access
from service.settings import Settings
from service.uploads import jobs
from service.uploads.accepted import Accepted
from service.uploads.job_records import JobRecord, read_job_record
from service.uploads.jobs import SHARES, Job, Uploads
from service.watch.watchdog import JOBS
from tests.drape.cloth.cloth_shapes import tube as tube_shape
from tests.drape.garment.garment_files import obj_text
from tests.drape.geometry.geometry_shapes import box
from tests.fixtures.meshes import garment_obj
from tests.fixtures.patience import ended_job, wait_until
from tests.fixtures.serving import files_in, served


@pytest.fixture(scope="module")
def upload_settings(make_settings: Callable[..., Settings]) -> Settings:
    return make_settings(intake_queue=6)


@pytest.fixture(scope="module")
def uploads(upload_settings: Settings) -> Iterator[httpx.Client]:
    with served(upload_settings) as url, httpx.Client(base_url=url, timeout=60.0) as client:
        yield client


def post(client: httpx.Client, content: bytes, **query: str) -> httpx.Response:
    return client.post("/garments", content=content, params=query, headers={"Content-Type": "application/octet-stream"})


def test_junk_fails_with_a_sentence_and_leaves_nothing(uploads: httpx.Client, upload_settings: Settings):
    junk = {"noise.obj": os.urandom(2000), "half.glb": b"glTF\x02\0\0\0\xff\0\0\0"}
    for name, content in junk.items():
        job = ended_job(uploads, post(uploads, content, name=name, avatar="standard"))
        assert job["state"] == "failed", name
        assert job["garment"] is None
        problem = job["problem"]
        assert problem["cure"] and problem["expected"] in problem["detail"]
        assert str(upload_settings.garments_dir) not in problem["detail"]
    assert [garment["source"] for garment in uploads.get("/garments").json()] == ["shipped"]
    wait_until(lambda: not files_in(upload_settings.garments_dir), missing="files")  # they go right after the job ends


def test_of_an_intakes_notes_the_warnings_are_told_and_kept(tmp_path: Path, tube: Garment):
    left_out = "a picture is left out"
    assert replace(tube, manifest={"notes": ["2 openings", f"warning: {left_out}"]}).warnings == (left_out,)
    JobRecord("one", "shirt", None, "done", "shirt", notes=(left_out,)).write(tmp_path)
    kept = read_job_record(tmp_path, "one")
    assert kept is not None and list(kept.notes) == [left_out]


@pytest.mark.slow
def test_a_good_file_becomes_a_garment_that_can_be_draped(
    uploads: httpx.Client, upload_settings: Settings, tube: Garment
):
    seen: list[dict] = []
    job = ended_job(uploads, post(uploads, garment_obj(tube), name="My Tube.obj", avatar="standard"), seen)
    assert (job["state"], job["notes"]) == ("done", []), job
    stages = [list(SHARES["garment"]).index(one["stage"]) for one in seen if one["stage"] is not None]
    assert stages == sorted(stages) and len(set(stages)) > 1
    shares = [one["share"] for one in [*seen, job]]
    assert shares == sorted(shares) and shares[-1] == 1.0
    info = uploads.get(f"/garments/{job['garment']}").json()
    assert (info["vertices"], info["source"]) == (216, "user")
    mesh = uploads.get(f"/garments/{job['garment']}/mesh").json()
    np.testing.assert_array_equal(mesh["faces"], tube.faces)
    draped = uploads.post("/drape", json={"garment": job["garment"], "poses": np.zeros((2, 24, 3)).tolist()})
    assert draped.headers["X-Drape-Vertices"] == "216"
    # Intake pushes the rest mesh 6 mm clear of the body, and the tiny model lifts it a little.
    moved = np.frombuffer(draped.content, "<f4").reshape(2, -1, 3)[0] - np.array(mesh["vertices"])
    assert np.abs(moved).max() < 0.1
    (stored,) = files_in(upload_settings.garments_dir)
    assert stored.name.startswith(job["garment"])
    stored.unlink()


def test_the_garments_in_a_file_come_as_drawn_and_over_each_other(
    uploads: httpx.Client, upload_settings: Settings, tube: Garment
):
    inner = tube.vertices[: tube.vertex_count].astype(np.float64)
    outer = inner * [1.3, 1.0, 1.3]
    points, corners = box((0.006, 0.006, 0.002))
    button = points + outer[np.abs(outer[:, 1] - outer[:, 1].mean()).argmin()] * [1.01, 1.0, 1.01]
    pieces = [(inner, tube.faces), (outer, tube.faces), (button, corners)]
    starts = np.cumsum([0] + [len(own) for own, _ in pieces])
    faces = np.concatenate([own + start for (_, own), start in zip(pieces, starts, strict=False)])
    suit = obj_text(np.concatenate([own for own, _ in pieces]), faces)
    job = ended_job(uploads, post(uploads, suit, name="suit.obj", avatar="standard"))
    assert job["state"] == "done" and job["wearer"] is None, job
    first, second = job["garments"]
    assert job["garment"] == second
    counts = [len(inner), len(outer) + len(button)]
    assert [uploads.get(f"/garments/{one}").json()["vertices"] for one in job["garments"]] == counts
    mesh = uploads.get(f"/garments/{second}/mesh").json()
    np.testing.assert_array_equal(mesh["faces"], faces[len(tube.faces) :] - len(inner))
    assert uploads.get(f"/garments/{second}/jets").headers["X-Drape-Vertices"] == str(counts[1])
    assert len(uploads.get(f"/garments/{second}/mesh?resolution=fine").json()["vertices"]) > len(outer)
    asked = {"garments": [first, second], "poses": np.zeros((1, 24, 3)).tolist(), "geometry": "vertices"}
    draped = uploads.post("/drape", json=asked)
    assert draped.headers["X-Drape-Vertices"] == str(sum(counts)), draped.text
    buttoned = np.frombuffer(draped.content, "<f4").reshape(-1, 3)[-len(button) :]
    sizes = [np.ptp(own, axis=0) for own in (buttoned, button)]
    assert np.linalg.norm(sizes[0]) == pytest.approx(np.linalg.norm(sizes[1]), rel=0.2)  # stiff, and turned a little
    glb = uploads.post("/drape", json=asked, headers={"Accept": "model/gltf-binary"})
    assert glb.content[:4] == b"glTF", glb.text
    for stored in files_in(upload_settings.garments_dir):
        stored.unlink()


def test_another_likely_wearer_is_told_and_chosen_by_its_options(uploads: httpx.Client, upload_settings: Settings):
    """A tube that is a skirt as well as a strapless top."""
    unit, faces = tube_shape(40, 14, radius_m=1.0, height_m=1.0)
    wrap = obj_text(100.0 * (unit * [0.16, 0.3, 0.12] + [0.3, 0.2, -0.2]), faces)
    heights = []
    first = ended_job(uploads, post(uploads, wrap, name="wrap.obj"))
    assert any("back to front" in note for note in first["notes"])  # a tube has no front
    other = next(other for other in first["wearer"]["others"] if other["facing"] == first["wearer"]["facing"])
    assert other["unit"] == "cm" and set(other) == set(first["wearer"]) - {"others"}
    second = ended_job(uploads, post(uploads, wrap, name="wrap.obj", **other["options"]))
    assert second["garment"] != first["garment"] and second["wearer"] is None, second
    for job in (first, second):
        mesh = uploads.get(f"/garments/{job['garment']}/mesh").json()
        heights.append(np.mean(mesh["vertices"], axis=0)[1])
    assert abs(heights[0] - heights[1]) > 0.15  # from the hips to the chest
    for stored in files_in(upload_settings.garments_dir):
        stored.unlink()


FORMATS = "format: expected one of obj, glb, gltf, ply, stl, usd, usda, usdc, usdz, fbx, zip, got"


@pytest.mark.parametrize(
    ("query", "content", "status", "word"),
    [
        ({}, b"x", 400, f"{FORMATS} nothing"),
        ({"name": "shirt.dae"}, b"x", 400, f"{FORMATS} the name shirt.dae. Export the garment as one of these."),
        ({"name": "shirt.obj", "avtar": "standard"}, b"x", 400, "avtar: expected no such parameter"),
        ({"name": "shirt", "format": "rar"}, b"x", 400, f"{FORMATS} rar"),
        ({"format": "obj"}, b"x", 400, "name: expected the garment's name"),
        ({"name": "shirt.obj"}, b"", 422, "bytes of a mesh file"),
        ({"name": "shirt.obj", "avatar": "/etc/passwd"}, b"x", 404, "avatar: expected a JSON object"),
        ({"name": "shirt.obj", "avatar": "body.obj"}, b"x", 404, "avatar"),
        ({"name": "shirt.obj", "avatar": "{not json"}, b"x", 422, "avatar: expected a JSON object"),
        ({"name": "shirt.obj", "avatar": '{"age": 1' + "0" * 5000 + "}"}, b"x", 422, "avatar: expected a JSON object"),
    ],
)
def test_an_upload_that_cannot_work_is_refused_at_once(
    uploads: httpx.Client, query: dict, content: bytes, status: int, word: str
):
    response = post(uploads, content, **query)
    assert response.status_code == status
    assert word in response.json()["detail"]


@pytest.mark.parametrize("kind", ["application/json", "Application/JSON; charset=utf-8"])
def test_a_file_inside_json_is_refused_and_the_cure_works(uploads: httpx.Client, kind: str):
    document = json.dumps({"name": "noise", "format": "obj", "data_base64": "ZiAxIDIgMw=="}).encode()
    for query in ({}, {"name": "noise.obj", "avatar": "standard"}):
        refused = uploads.post("/garments", content=document, params=query, headers={"Content-Type": kind})
        assert refused.status_code == 400
        assert "request body: expected the bytes of a mesh file, got JSON." in refused.json()["detail"]
    told = re.search(r"(\?\S+) and Content-Type: ([\w/-]+)", refused.json()["cure"])
    assert told is not None
    content = {"content": b"f 1 2 3", "headers": {"Content-Type": told[2]}}
    assert ended_job(uploads, uploads.post(f"/garments{told[1]}", **content))["state"] == "failed"


def test_content_types_name_the_format(uploads: httpx.Client):
    response = uploads.post("/garments?name=shirt", content=b"junk", headers={"Content-Type": "model/gltf-binary"})
    job = ended_job(uploads, response)
    assert job["state"] == "failed" and job["name"] == "shirt"


def test_a_folder_that_may_not_be_written_is_told(make_settings: Callable[..., Settings], tmp_path: Path):
    (tmp_path / "file").touch()  # nobody may make a folder in it, root neither
    with served(make_settings(garments_dir=tmp_path / "file" / "garments")) as url:
        answer = httpx.post(f"{url}/garments?name=cloth.obj", content=b"v 0 0 0", timeout=60.0)
    assert answer.status_code == 503
    assert "folder of garments: expected one that the service can write to" in answer.json()["detail"]


def test_a_full_queue_is_refused(make_settings: Callable[..., Settings]):
    with served(make_settings(intake_queue=1)) as url, httpx.Client(base_url=url) as client:
        first = post(client, b"v 0 0 0\n", name="a.obj")
        second = post(client, b"v 0 0 0\n", name="b.obj")
        assert second.status_code == 429 and "uploads" in second.json()["detail"]
        ended_job(client, first)


def test_two_workers_run_two_uploads_and_a_client_that_leaves_cancels_its_own(
    make_settings: Callable[..., Settings], tube: Garment
):
    settings = make_settings(intake_workers=2)
    with served(settings) as url, DrapeClient(url) as client:
        api = httpx.Client(base_url=url)
        other = post(api, garment_obj(tube), name="other.obj", avatar="standard").json()
        path = settings.garments_dir / "mine.obj"
        path.write_bytes(garment_obj(tube))
        mine: list[str] = []

        def told(job: dict) -> None:
            mine.append(job["id"])
            if job["state"] == "running" and api.get(f"/jobs/{other['id']}").json()["state"] == "running":
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            client.upload_garment(path, "standard", progress=told)
        assert api.get(f"/jobs/{mine[0]}").json()["state"] == "cancelled"
        assert api.get(f"/jobs/{other['id']}").json()["state"] == "running"
        api.delete(f"/jobs/{other['id']}")
        api.close()


def test_an_intake_that_is_ended_from_outside_is_told_by_its_status(uploads: httpx.Client, tube: Garment):
    sent = post(uploads, garment_obj(tube), name="tube.obj", avatar="standard")
    clocks = wait_until(lambda: next((one.clocks for one in tuple(JOBS) if one.lane == "intake"), None))
    os.kill(clocks[0].args[0], signal.SIGTERM)  # pyright: ignore[reportAttributeAccessIssue]
    job = ended_job(uploads, sent)
    assert job["state"] == "failed" and "a file on which the intake ends with status -15" in job["problem"]["detail"]


def test_cancelled_uploads_end_and_leave_nothing(uploads: httpx.Client, upload_settings: Settings, tube: Garment):
    running, waiting = (post(uploads, garment_obj(tube), name="tube.obj", avatar="standard").json() for _ in range(2))
    wait_until(lambda: uploads.get(f"/jobs/{running['id']}").json()["state"] == "running")
    assert uploads.get(f"/jobs/{waiting['id']}").json()["state"] == "queued"
    for job in (waiting, running):
        assert uploads.delete(f"/jobs/{job['id']}").status_code == 204
        found = uploads.get(f"/jobs/{job['id']}").json()
        assert (found["state"], found["stage"], found["garment"], found["share"]) == ("cancelled", None, None, 0.0)
    assert files_in(upload_settings.garments_dir) == []
    mine = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout
    assert str(upload_settings.garments_dir) not in mine
    assert uploads.delete(f"/jobs/{running['id']}").status_code == 204  # it has ended: it is forgotten
    assert uploads.get(f"/jobs/{running['id']}").status_code == 404
    assert ended_job(uploads, post(uploads, b"v 0 0 0\n", name="next.obj", avatar="standard"))["state"] == "failed"


def test_a_garment_that_is_cancelled_as_it_is_stored_is_not_kept(
    make_settings: Callable[..., Settings], tube: Garment, monkeypatch: pytest.MonkeyPatch
):
    settings = make_settings()
    runtime = DrapeRuntime(settings)
    uploads = Uploads(runtime, SlicedThread(), Access(settings))
    accepted = Accepted("one", "tube", None, "tube.obj", "standard")
    folder = settings.garments_dir / "work"
    (folder / "out").mkdir(parents=True)
    made = save_garment(tube, folder / "out")

    async def as_taken_in(*_: object, **__: object) -> dict[str, list[str]]:
        return {"files": [made.name]}

    async def cancelled() -> None:
        job = Job("one", "tube")
        work = asyncio.create_task(uploads._run_intake(job, folder, accepted))
        while not (settings.garments_dir / made.name).exists():
            await asyncio.sleep(0)
        work.cancel()
        await asyncio.wait([work])
        assert work.cancelled()

    monkeypatch.setattr(jobs, "run_sandbox", as_taken_in)
    asyncio.run(cancelled())
    assert not (settings.garments_dir / made.name).exists()
    runtime.close()
