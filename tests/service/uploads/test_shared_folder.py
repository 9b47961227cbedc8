"""Two services with one folder of uploads: what one is told, the other knows."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest
from fastapi import FastAPI
from websockets.asyncio.client import connect

from drape.avatar.wearer import save_wearer
from drape.body.model import BodyModel
from drape.errors import NotFound
from drape.garment.cache import Garment, save_garment
from service.app import create_app
from service.compute import garment_files
from service.settings import Settings
from service.uploads import accepted, job_records
from service.uploads.accepted import CANCEL, Accepted, find_elsewhere, staging_folder, take_over, touch
from service.uploads.job_records import JobRecord
from tests.fixtures.characters import bare_wearer
from tests.fixtures.garments import tube_garment
from tests.fixtures.meshes import garment_obj
from tests.fixtures.patience import PATIENT_S, wait_until
from tests.fixtures.serving import serve
from tests.fixtures.streams import PROTOCOLS

LOOK_S = 0.5
REST = np.zeros((1, 24, 3)).tolist()


@pytest.fixture(scope="module")
def apps(make_settings: Callable[..., Settings]) -> tuple[FastAPI, FastAPI]:
    settings = make_settings(garments_look_s=LOOK_S)
    return create_app(settings), create_app(settings)


@pytest.fixture(scope="module")
def pair(apps: tuple[FastAPI, FastAPI], make_settings: Callable[..., Settings]) -> Iterator[tuple[httpx.Client, ...]]:
    settings = make_settings()
    with (
        serve(apps[0], settings) as one,
        serve(apps[1], settings) as other,
        httpx.Client(base_url=one, timeout=60.0) as here,
        httpx.Client(base_url=other, timeout=60.0) as there,
    ):
        yield here, there


@pytest.fixture(scope="module")
def folder(apps: tuple[FastAPI, FastAPI], pair: tuple[httpx.Client, ...]) -> Path:
    return apps[0].state.drape.runtime.settings.garments_dir


def sent(client: httpx.Client, content: bytes, name: str) -> dict:
    query = {"name": name, "avatar": "standard"}
    response = client.post(
        "/garments", content=content, params=query, headers={"Content-Type": "application/octet-stream"}
    )
    assert response.status_code == 202, response.text
    return response.json()


@pytest.mark.slow
def test_a_garment_that_one_takes_in_the_other_drapes(pair: tuple[httpx.Client, ...], tube: Garment):
    here, there = pair
    job, seen = sent(here, garment_obj(tube), "gown.obj"), set()

    def ended() -> bool:
        found = there.get(f"/jobs/{job['id']}").json()
        seen.add(found["state"])
        return found["state"] not in ("queued", "running")

    wait_until(ended, 90.0)
    assert seen <= {"queued", "running", "done"} and len(seen) > 1
    told = there.get(f"/jobs/{job['id']}").json()
    assert (told["garment"], told["share"]) == ("gown", 1.0)
    answers = [one.post("/drape", json={"garment": "gown", "poses": REST}) for one in (there, here)]
    assert answers[0].status_code == 200 and answers[0].content == answers[1].content
    assert there.delete("/garments/gown").status_code == 204
    wait_until(lambda: here.get("/garments/gown").status_code == 404)
    assert there.delete(f"/jobs/{job['id']}").status_code == 204
    assert here.get(f"/jobs/{job['id']}").status_code == 404


def test_a_garment_is_known_at_once_where_somebody_asks_for_it(
    pair: tuple[httpx.Client, ...], folder: Path, body: BodyModel
):
    for number, client in enumerate(pair):
        save_garment(tube_garment(body, name=f"new{number}", radius_m=0.2), folder)
        assert client.get(f"/garments/new{number}").status_code == 200
        assert client.get("/garments/nothing").status_code == 404


def test_an_avatar_that_one_has_the_other_knows_at_once(
    apps: tuple[FastAPI, FastAPI], pair: tuple[httpx.Client, ...], tmp_path: Path
):
    here, there = pair
    made, source = save_wearer(replace(bare_wearer(), name="guest"), tmp_path), tmp_path / "guest.glb"
    source.write_bytes(b"")
    apps[0].state.drape.runtime.avatars.add(made, source, None)
    drapes = [one.post("/drape", json={"garment": "tube", "avatar": "guest", "poses": REST}) for one in (there, here)]
    assert drapes[0].status_code == 200 and drapes[0].content == drapes[1].content
    assert there.delete("/avatars/guest").status_code == 204
    wait_until(lambda: here.get("/avatars/guest").status_code == 404)


def test_what_is_changed_or_deleted_at_one_is_at_the_other(
    pair: tuple[httpx.Client, ...], folder: Path, body: BodyModel
):
    here, there = pair
    save_garment(tube_garment(body, name="robe", radius_m=0.23), folder)
    assert {client.get("/garments/robe").json()["name"] for client in pair} == {"robe"}
    assert here.patch("/garments/robe", json={"name": "Kleid"}).status_code == 200
    wait_until(lambda: there.get("/garments/robe").json()["name"] == "Kleid")

    async def worn() -> int | None:
        address = str(there.base_url).replace("http", "ws").rstrip("/") + "/stream"
        async with connect(address, subprotocols=PROTOCOLS) as socket:
            await socket.send(json.dumps({"type": "open", "garment": "robe"}))
            await socket.recv()
            assert (await asyncio.to_thread(here.delete, "/garments/robe")).status_code == 204
            await asyncio.wait_for(socket.wait_closed(), PATIENT_S)
            return socket.close_code

    assert asyncio.run(worn()) == 4404
    assert there.get("/garments/robe").status_code == 404


def test_equal_names_have_the_same_ids_everywhere(pair: tuple[httpx.Client, ...], folder: Path, body: BodyModel):
    for radius_m in (0.24, 0.25):
        made = tube_garment(body, name="twin", radius_m=radius_m)
        save_garment(replace(made, digest=f"{radius_m} {made.digest}"), folder)
    wait_until(lambda: all(len(twins(client)) == 2 for client in pair))
    assert twins(pair[0]) == twins(pair[1])


def twins(client: httpx.Client) -> dict[str, str]:
    """The mesh of each garment that is called twin."""
    ids = [one["id"] for one in client.get("/garments").json() if one["name"] == "twin"]
    return {name: client.get(f"/garments/{name}/mesh").text for name in ids}


def test_a_broken_file_is_set_aside_and_the_rest_followed(
    pair: tuple[httpx.Client, ...], folder: Path, body: BodyModel
):
    (folder / "broken.npz").write_bytes(b"not a cache")
    save_garment(tube_garment(body, name="sound", radius_m=0.26), folder)
    assert [client.get("/garments/sound").status_code for client in pair] == [200, 200]
    assert [client.get("/readyz").status_code for client in pair] == [200, 200]
    (folder / "broken.npz").unlink()


def test_an_upload_is_cancelled_at_either(pair: tuple[httpx.Client, ...], tube: Garment):
    here, there = pair
    job = sent(here, garment_obj(tube), "tube.obj")
    wait_until(lambda: there.get(f"/jobs/{job['id']}").json()["state"] == "running")
    assert there.delete(f"/jobs/{job['id']}").status_code == 204
    assert there.get(f"/jobs/{job['id']}").json()["state"] == "cancelled"
    wait_until(lambda: here.get(f"/jobs/{job['id']}").json()["state"] == "cancelled")
    wait_until(lambda: here.get("/health").json()["status"] == "ok")


def test_a_service_that_has_its_folder_alone_does_not_look(api: httpx.Client, settings: Settings, body: BodyModel):
    path = save_garment(tube_garment(body, name="unseen", radius_m=0.2), settings.garments_dir)
    assert api.get("/garments/unseen").status_code == 404
    path.unlink()


def test_unknown_garments_cost_one_look(apps: tuple[FastAPI, FastAPI], pair: tuple[httpx.Client, ...], monkeypatch):
    looked, stored = [], garment_files.list_caches

    def counted(root: Path) -> dict[Path, tuple[int, int]]:
        looked.append(root)
        return stored(root)

    monkeypatch.setattr(garment_files, "list_caches", counted)
    shared_folder, url = apps[0].state.drape.shared_folder, str(pair[0].base_url)

    async def many() -> set[int]:
        async with httpx.AsyncClient(base_url=url, timeout=60.0) as client:
            answers = await asyncio.gather(*(client.get(f"/garments/none{number}") for number in range(40)))
            return {answer.status_code for answer in answers}

    begun_s = time.monotonic()
    assert asyncio.run(many()) == {404}
    # Both services look every LOOK_S besides.
    assert len(looked) <= (time.monotonic() - begun_s) * (1.0 / 0.25 + 2.0 / LOOK_S) + 3.0
    assert shared_folder.runs


# --- on disk ---


def test_an_id_belongs_to_whom_claimed_it_first(tmp_path: Path):
    first, second = tmp_path / "shirt-1.npz", tmp_path / "shirt-2.npz"
    for path in (first, second):
        path.touch()
    assert garment_files.claim(first, "shirt") and not garment_files.claim(second, "shirt")
    assert garment_files.claim(first, "shirt")
    garment_files.remove_cache(second, "shirt")  # not its own
    assert not garment_files.claim(second, "shirt")
    first.unlink()
    second.touch()
    assert garment_files.claim(second, "shirt")  # who had it is gone
    assert [path.name for path in (tmp_path / garment_files.IDS).iterdir()] == ["shirt"]
    garment_files.remove_cache(second, "shirt")
    assert list((tmp_path / garment_files.IDS).iterdir()) == []


def test_of_records_the_newest_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(job_records, "KEPT", 3)
    for number in range(5):
        JobRecord(f"{number:012x}", "shirt", None, "done", "shirt").write(tmp_path)
        os.utime(tmp_path / job_records.FOLDER / f"{number:012x}.json", (number, number))
    assert [job_records.read_job_record(tmp_path, f"{number:012x}") is not None for number in range(5)] == [
        False, False, True, True, True,
    ]  # fmt: skip
    job_records.remove_record(tmp_path, f"{4:012x}")
    job_records.remove_record(tmp_path, f"{4:012x}")
    assert job_records.read_job_record(tmp_path, f"{4:012x}") is None


def test_uploads_of_another_host_are_taken_over_when_nothing_is_heard_of_it(tmp_path: Path):
    far, own = tmp_path / ".staging-0badcafe-elsewhere-1", staging_folder(tmp_path)
    upload = Accepted("a" * 12, "shirt", None, "shirt.obj", "standard", 1)
    (far / upload.id).mkdir(parents=True)
    (far / upload.id / upload.file).write_bytes(b"v 0 0 0")
    upload.write(far / upload.id)
    assert find_elsewhere(tmp_path, own, upload.id) == (upload, far / upload.id)
    assert list(take_over(tmp_path, own, shared=True)) == []
    old_s = time.time() - accepted.SILENT_S - 1.0
    os.utime(far, (old_s, old_s))
    touch(far)
    assert list(take_over(tmp_path, own, shared=True)) == []
    os.utime(far, (old_s, old_s))
    assert list(take_over(tmp_path, own, shared=True)) == [(upload, own / upload.id)]
    assert not far.exists() and find_elsewhere(tmp_path, own, upload.id) is None
    assert list(take_over(tmp_path, staging_folder(tmp_path), shared=True)) == []  # that service runs


def test_a_service_goes_on_with_what_another_that_ended_had_accepted(
    pair: tuple[httpx.Client, ...], folder: Path, tube: Garment
):
    ended = subprocess.Popen(["true"])
    ended.wait()
    job_id = "b" * 12
    upload, home = Accepted(job_id, "left", None, "left.obj", "standard"), folder / f".staging-{ended.pid}" / job_id
    making = folder.parent / "making" / job_id
    making.mkdir(parents=True)
    (making / upload.file).write_bytes(b"v one two three\n")
    upload.write(making)
    home.parent.mkdir()
    os.rename(making, home)
    wait_until(lambda: {one.get(f"/jobs/{job_id}").json().get("state") for one in pair} == {"failed"}, 60.0)
    assert not home.exists()


def test_a_mark_to_cancel_is_left_where_the_upload_lies(
    apps: tuple[FastAPI, FastAPI], pair: tuple[httpx.Client, ...], folder: Path
):
    far = folder / ".staging-0badcafe-elsewhere-1" / ("c" * 12)
    far.mkdir(parents=True)
    upload = Accepted(far.name, "shirt", None, "shirt.obj", "standard")
    (far / upload.file).write_bytes(b"v 0 0 0")
    upload.write(far)
    uploads = apps[0].state.drape.uploads
    with pytest.raises(NotFound):
        uploads.get(far.name, "somebody")
    for wrong in ("../" + far.name, "c" * 11, "*" * 12):
        with pytest.raises(NotFound):
            uploads.get(wrong)
    assert pair[1].get(f"/jobs/{far.name}").json()["state"] == "queued"
    assert pair[1].delete(f"/jobs/{far.name}").status_code == 204
    assert (far / CANCEL).exists() and pair[0].get(f"/jobs/{far.name}").json()["state"] == "cancelled"
