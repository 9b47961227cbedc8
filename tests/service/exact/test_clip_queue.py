"""Clips of tier exact: a job from its request to its files, its resumption, and how each way to fail is told."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import httpx
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from clients.cli import main
from clients.client import DrapeClient
from drape.errors import DrapeError, MotionError, NotFound, Unavailable
from service.errors import Busy, Full
from service.exact import clip_folder as on_disk
from service.exact import clip_queue
from service.exact.block import FrameBlock
from service.exact.clip_queue import ExactClips
from service.http.exact_clips import exact_job_info
from service.settings import Settings
from tests.fixtures.patience import ended_job, wait_until
from tests.fixtures.serving import served
from tests.fixtures.streams import raw_stream

FRAMES = 3
POSES = np.zeros((FRAMES, 24, 3))
POSES[:, 16, 2] = -0.1 * np.arange(FRAMES)
ASKED = {"garment": "tube", "poses": POSES.tolist(), "fps": 10.0, "tier": "exact"}


@pytest.fixture(scope="module")
def exact_settings(make_settings: Callable[..., Settings]) -> Settings:
    return make_settings(exact_workers=2)


@pytest.fixture(scope="module")
def url(exact_settings: Settings) -> Iterator[str]:
    with served(exact_settings) as address:
        yield address


@pytest.fixture(scope="module")
def client(url: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=url, timeout=60.0) as http:
        yield http


@pytest.fixture(scope="module")
def done(client: httpx.Client) -> str:
    """The address of a clip that is done."""
    answer = client.post("/drape", json=ASKED)
    assert answer.status_code == 202, answer.text
    where = answer.headers["Location"]
    job = answer.json()
    assert where == f"/jobs/{job['id']}" and job["frames"] == FRAMES and job["state"] in ("queued", "running")
    assert ended_job(client, where)["state"] == "done"
    return where


def test_every_frame_is_told_and_comes_to_rest_apart(client: httpx.Client, done: str):
    job = client.get(done).json()
    assert [frame["frame"] for frame in job["told"]] == list(range(FRAMES)) and job["share"] == 1.0
    for frame in job["told"]:
        assert frame["crossings"] == 0 and frame["force_share"] <= 0.01
        assert frame["energy_j"] < frame["start_j"] and 0.0 <= frame["depth_m"] < 0.004
    assert job["notes"] == []


def test_a_frame_that_is_not_solved_is_named(tmp_path: Path):
    told = {"force_share": 0.009, "depth_m": 0.0, "energy_j": 1.0, "start_j": 2.0, "start_crossings": 3, "steps": 4}
    frames = {0: {**told, "crossings": 0}, 1: {**told, "crossings": 2, "depth_m": 0.0634}}
    frames[2] = {**told, "crossings": 0, "force_share": 18.0}
    job = clip_queue.ClipJob(on_disk.AcceptedClip("a", "tube", None, 3), tmp_path, state="done", figures=frames)
    first, second = exact_job_info(job).notes
    assert first.startswith("Frame 1 is not solved: 2 pairs") and "63.4 mm deep" in first and "0.9 %" in first
    assert second.startswith("Frame 2 is not solved: 0 pairs") and "1800.0 %" in second


def test_the_clip_comes_in_the_formats_of_clips(client: httpx.Client, done: str):
    binary = client.get(f"{done}/clip")
    assert binary.headers["X-Drape-Tier"] == "exact" and binary.headers["X-Drape-Crossings"] == "0"
    assert 0.0 < float(binary.headers["X-Drape-Force-Left"]) <= 0.01
    vertices = np.frombuffer(binary.content, "<f4").reshape(FRAMES, -1, 3)
    document = client.get(f"{done}/clip", headers={"Accept": "application/json"}).json()
    assert document["fps"] == 10.0
    assert_array_equal(np.array(document["positions"], np.float32), vertices)
    cache = client.get(f"{done}/clip", headers={"Accept": "application/x-pc2"}).content
    assert_array_equal(np.frombuffer(cache, "<f4", offset=32).reshape(vertices.shape), vertices)
    for kind, begin in (("model/gltf-binary", b"glTF"), ("model/vnd.usda", b"#usda")):
        answer = client.get(f"{done}/clip", headers={"Accept": kind})
        assert answer.status_code == 200 and answer.content.startswith(begin)
    accurate = client.post("/drape", json={**ASKED, "tier": "accurate", "motion": 0})
    start = np.frombuffer(accurate.content, "<f4").reshape(vertices.shape)
    assert 1e-4 < np.abs(vertices - start).max() < 0.05


def test_the_client_and_the_command_wait_for_it(url: str, done: str, tmp_path: Path, capsys):
    job = {"job": done.rpartition("/")[2]}
    with DrapeClient(url) as client:
        seen: list[dict] = []
        vertices = client.exact("tube", POSES, more=job, progress=seen.append)
        assert vertices.shape[0] == FRAMES and seen[-1]["state"] == "done"
        assert client.exact("tube", POSES, more=job, glb=True).startswith(b"glTF")
    command = ["drape", "--url", url, "--garment", "tube", "--motion", "walk", "--tier", "exact", "--job", job["job"]]
    out = tmp_path / "out.npy"
    assert main([*command, "--out", str(out)]) == 0
    said = capsys.readouterr().err
    assert said.startswith(f"job {job['job']}: 3 frames\n")
    assert f"job {job['job']}: frame 2, 3 of 3: force left" in said
    assert out.read_bytes().endswith(vertices.tobytes())  # the head counts the frames of the motion
    assert main([*command, "--garment", "tube", "tube", "--out", str(out)]) == 2
    assert "one with tier exact" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "name"),
    [
        ({"folds": 2}, "folds"),
        ({"passes": 1}, "passes"),
        ({"passes": 0}, "passes"),
        ({"advanced": {"folds": 0}}, "folds"),
        ({"advanced": {"coarse": True}}, "coarse"),
        ({"motion": 1.0}, "motion"),
        ({"geometry": "jets"}, "geometry"),
        ({"streamed": True}, "streamed"),
        ({"keep": True}, "keep"),
        ({"colliders": [{"kind": "plane", "normal": [0, 1, 0], "offset_m": 0.0}]}, "colliders"),
        ({"garment": None, "garments": ["tube", "tube"]}, "garments"),
    ],
)
def test_what_no_exact_clip_has_is_refused_by_name(client: httpx.Client, more: dict, name: str):
    answer = client.post("/drape", json=ASKED | more)
    assert (answer.status_code, answer.json()["name"]) == (400, name), answer.text


def test_a_stream_is_told_the_way_to_the_job(url: str):
    with raw_stream(url) as stream:
        refused = stream.open(garment="tube", tier="exact")
    assert refused["name"] == "tier" and "POST /drape" in refused["cure"]


def test_a_clip_that_is_not_done_or_not_there_is_refused(client: httpx.Client):
    assert client.get("/jobs/0123456789ab/clip").status_code == 404
    where = client.post("/drape", json=ASKED).headers["Location"]
    early = client.get(f"{where}/clip")
    assert early.status_code == 503 and "until it is done" in early.json()["cure"]
    assert client.delete(where).status_code == 204
    assert client.get(where).status_code == 404


def test_a_job_that_is_cancelled_leaves_nothing(client: httpx.Client, exact_settings: Settings, done: str):
    where = client.post("/drape", json=ASKED).headers["Location"]
    wait_until(lambda: client.get(where).json()["stage"] == "frames")
    assert client.delete(where).status_code == 204
    kept = [path.name for path in (exact_settings.garments_dir / on_disk.FOLDER).iterdir()]
    assert kept == [done.rpartition("/")[2]]


def test_a_service_that_is_started_again_goes_on_from_the_frames_it_has(make_settings: Callable[..., Settings]):
    settings = make_settings()
    asked, count = ASKED | {"poses": 3 * POSES.tolist()}, 3 * FRAMES  # more than a slow end of a service computes
    with served(settings) as url, httpx.Client(base_url=url, timeout=60.0) as http:
        where = http.post("/drape", json=asked).headers["Location"]
        wait_until(lambda: 1 <= len(http.get(where).json()["told"]) < count)
    folder = settings.garments_dir / on_disk.FOLDER / where.rpartition("/")[2]
    before = {path.name: path.stat().st_mtime_ns for path in folder.glob("*.npz")}
    assert 1 <= len(before) < count
    with served(settings) as url, httpx.Client(base_url=url, timeout=60.0) as http:
        resumed = ended_job(http, where)
        assert resumed["state"] == "done", resumed
        divided = http.get(f"{where}/clip").content
        assert {name: (folder / name).stat().st_mtime_ns for name in before} == before
        whole = http.post("/drape", json=asked).headers["Location"]
        assert ended_job(http, whole)["state"] == "done"
        assert http.get(f"{whole}/clip").content == divided  # to the bit
        kept = http.get(where).json()
    with served(settings) as url, httpx.Client(base_url=url, timeout=60.0) as http:
        assert http.get(where).json() == kept  # one that is done as well


def test_a_frame_that_takes_too_long_ends_the_job_in_words(make_settings: Callable[..., Settings], monkeypatch):
    monkeypatch.setattr(clip_queue, "FRAME_S", 0.05)
    settings = make_settings()
    with served(settings) as url, httpx.Client(base_url=url, timeout=60.0) as http:
        where = http.post("/drape", json=ASKED).headers["Location"]
        job = ended_job(http, where)
        assert job["state"] == "failed" and "frame 0" in job["problem"]["name"]
        assert job["problem"]["cure"] == "Leave this frame's pose out."
        with pytest.raises(DrapeError, match=r"within 0\.05 s"), DrapeClient(url) as client:
            client.exact("tube", POSES, more={"job": where.rpartition("/")[2]})
    folder = settings.garments_dir / on_disk.FOLDER / where.rpartition("/")[2]
    assert sorted(path.name for path in folder.iterdir()) == [on_disk.ABOUT, on_disk.LOCK]
    with served(settings) as url, httpx.Client(base_url=url, timeout=60.0) as http:
        assert http.get(where).json()["problem"] == job["problem"]


class Nothing:
    """What the queue needs of a runtime before it computes."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings


def test_too_many_clips_and_a_full_disk_are_refused(make_settings: Callable[..., Settings], monkeypatch):
    clips = ExactClips(Nothing(make_settings(intake_queue=1, max_stored_bytes=10_000)))  # pyright: ignore[reportArgumentType]
    with pytest.raises(Full, match="DELETE /jobs/ID"):
        clips.check_place(10, 1000)
    monkeypatch.setattr(clip_queue, "_free_bytes", lambda root: 100)
    with pytest.raises(Full, match="100 free on disk"):
        clips.check_place(1, 10)

    def full(self: on_disk.AcceptedClip, folder: Path) -> None:
        raise OSError(28, "No space left on device")

    async def submit() -> None:
        monkeypatch.setattr(on_disk.AcceptedClip, "write", full)
        with pytest.raises(Full, match="No space left"):
            await clips.submit("tube", None, b"", 1)
        assert clips.waiting == 0 and list((clips._root / on_disk.FOLDER).iterdir()) == []
        monkeypatch.undo()
        await clips.submit("tube", None, b"", 1)
        with pytest.raises(Busy, match="exact clips"):
            clips.check_place(1, 1)
        await clips.stop()

    asyncio.run(submit())


def test_what_a_process_says_at_its_end_is_raised(make_settings: Callable[..., Settings], tmp_path: Path, monkeypatch):
    clips = ExactClips(Nothing(make_settings()))  # pyright: ignore[reportArgumentType]
    job = clip_queue.ClipJob(on_disk.AcceptedClip("a", "tube", None, 2), tmp_path)

    names = (f"spoken_{number}" for number in count())  # byte code of one module would be taken for another's

    def computed(program: str) -> None:
        (tmp_path / f"{(name := next(names))}.py").write_text(program)
        monkeypatch.setattr(clip_queue, "BLOCK", name)
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))
        some = np.zeros(1)
        block = FrameBlock(None, None, None, some, some, tmp_path, some, some)  # pyright: ignore[reportArgumentType]
        asyncio.run(clips._compute(job, block))

    said = {"name": "disk", "expected": "room for a frame", "got": "No space left", "cure": "Make room, and ask again."}
    for kind in (Unavailable, MotionError):
        problem = {"problem": {"kind": kind.__name__, **said}}
        with pytest.raises(kind, match=r"disk: .*No space left"):
            computed(f"print({json.dumps(json.dumps(problem))})")
    with pytest.raises(Unavailable, match=r"frame 0: .*status 3"):
        computed("raise SystemExit(3)")


def test_a_clip_that_was_begun_too_often_and_missing_frames_are_refused(
    make_settings: Callable[..., Settings], tmp_path
):
    clips = ExactClips(Nothing(make_settings()))  # pyright: ignore[reportArgumentType]
    job = clip_queue.ClipJob(on_disk.AcceptedClip("a", "tube", None, 2, attempts=clip_queue.MOST_ATTEMPTS), tmp_path)
    with pytest.raises(Unavailable, match="within 20 starts"):
        asyncio.run(clips._run(job, None))  # pyright: ignore[reportArgumentType]
    with pytest.raises(NotFound, match="0 of 2 frames"):
        clips.vertices(job, None)  # pyright: ignore[reportArgumentType]


def test_a_folder_is_computed_by_one_service_at_a_time(tmp_path: Path):
    first = on_disk.Lock(tmp_path)
    second = on_disk.Lock(tmp_path)
    assert first.held and not second.held
    first.release()
    assert on_disk.Lock(tmp_path).held
