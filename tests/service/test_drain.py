"""The end of a service: streams are told, clips and half-sent bodies get an answer, uploads go on after a restart."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

import httpx
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from drape.wire import messages as wire
from service.app import create_app
from service.compute.threads import ComputeThreads
from service.errors import Busy, Draining
from service.guard.access import Access
from service.settings import Settings
from service.uploads.accepted import UNREADABLE, Accepted, staging_folder, take_over
from service.uploads.jobs import MOST_ATTEMPTS
from tests.fixtures.patience import PATIENT_S, ended_job
from tests.fixtures.serving import files_in, process, serve, served
from tests.fixtures.streams import PROTOCOLS, raw_stream, stream_address


def test_a_service_that_is_told_to_end_says_so_and_goes_on_later(make_settings: Callable[..., Settings]):
    settings = make_settings()
    long = {"garment": "tube", "poses": np.zeros((1200, 24, 3)).tolist()}
    answers: list[httpx.Response] = []
    with process(settings) as (service, url):
        host, port = url.removeprefix("http://").split(":")
        half = socket.create_connection((host, int(port)))
        half.sendall(b"POST /drape HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n")
        half.sendall(b"Content-Length: 9\r\n\r\n{")
        half.settimeout(PATIENT_S)
        asking = threading.Thread(target=lambda: answers.append(httpx.post(url + "/drape", json=long, timeout=60.0)))
        jobs = [httpx.post(url + f"/garments?name={name}.obj", content=b"v 0 0 0\n").json() for name in "abc"]
        with connect(stream_address(url), subprotocols=PROTOCOLS) as stream:
            stream.send(json.dumps({"type": "open", "garment": "tube"}))
            stream.recv()
            asking.start()
            while "drape_clips 1.0" not in httpx.get(url + "/metrics").text:
                assert asking.is_alive(), "it has been answered already"
            service.send_signal(signal.SIGTERM)
            said = json.loads(stream.recv(timeout=PATIENT_S))
            with pytest.raises(ConnectionClosed) as closed:
                stream.recv(timeout=PATIENT_S)
        assert (said["type"], said["kind"]) == ("error", "Draining") and "Connect again" in said["cure"]
        assert closed.value.rcvd is not None
        assert (closed.value.rcvd.code, closed.value.rcvd.reason[:28]) == (1012, "service: expected one that t")
        assert half.recv(4096).startswith(b"HTTP/1.1 503")
        asking.join(PATIENT_S)
        _, log = service.communicate(timeout=PATIENT_S)
    assert answers[0].status_code in (200, 503)  # a fast machine is through by then
    assert answers[0].status_code == 200 or "one that is being restarted" in answers[0].json()["detail"]
    assert [line for line in log.splitlines() if "exception" in json.loads(line)] == []
    left = {folder.name for folder in settings.garments_dir.glob(".staging-*/*")}
    assert jobs[-1]["id"] in left <= {job["id"] for job in jobs}
    with served(settings) as again, httpx.Client(base_url=again) as client:
        for job in [job for job in jobs if job["id"] in left]:
            found = ended_job(client, f"/jobs/{job['id']}")
            assert (found["state"], found["name"]) == ("failed", job["name"])  # as no mesh is
    assert files_in(settings.garments_dir) == []


def accepted(folder: Path, name: str, attempts: int = 0) -> Accepted:
    """An upload as an ended process left it."""
    one = Accepted(id=name, name=name, owner=None, file=f"{name}.obj", avatar=None, attempts=attempts)
    (folder / name / "out").mkdir(parents=True)
    (folder / name / one.file).write_bytes(b"v 0 0 0\n")
    one.write(folder / name)
    return one


def test_an_upload_whose_record_cannot_be_read_is_kept(tmp_path: Path):
    ended = subprocess.Popen(["true"])
    ended.wait()
    theirs, own = tmp_path / f".staging-{ended.pid}", staging_folder(tmp_path)
    whole = accepted(theirs, "whole")
    accepted(theirs, "later")
    (theirs / "later/job.json").write_text('{"id": "later", "file": ["of", "another", "version"]}')
    for taken in ([(whole, own / "whole")], []):
        assert list(take_over(tmp_path, own)) == taken and not theirs.exists()
        assert (tmp_path / UNREADABLE / "later/later.obj").read_bytes() == b"v 0 0 0\n"


def test_uploads_of_ended_processes_are_taken_over_in_their_order(tmp_path: Path):
    ended = subprocess.Popen(["true"])
    ended.wait()
    # In a container the number of a process comes again: before this one it was another's.
    theirs, before, running = (tmp_path / f".staging-{pid}" for pid in (ended.pid, os.getpid(), os.getppid()))
    own = staging_folder(tmp_path)
    second, first, third = accepted(theirs, "late"), accepted(before, "early"), accepted(running, "busy")
    os.utime(before / "early/early.obj", (1.0, 1.0))
    (theirs / "half").mkdir()
    (theirs / "half/half.obj").write_bytes(b"v")
    assert list(take_over(tmp_path, own)) == [(first, own / "early"), (second, own / "late")]
    assert sorted(path.name for path in own.rglob("*")) == [
        "early",
        "early.obj",
        "job.json",
        "job.json",
        "late",
        "late.obj",
    ]
    assert not theirs.exists() and not before.exists() and (running / third.id / third.file).is_file()


def test_an_upload_that_ends_every_service_is_given_up(make_settings: Callable[..., Settings]):
    settings = make_settings()
    job_id = "bad" * 4
    accepted(settings.garments_dir / ".staging-0", job_id, attempts=MOST_ATTEMPTS)  # no process has this id for long
    os.rename(settings.garments_dir / ".staging-0", settings.garments_dir / f".staging-{os.getpid()}")
    with served(settings) as url, httpx.Client(base_url=url) as client:
        job = ended_job(client, f"/jobs/{job_id}")
    assert f"within {MOST_ATTEMPTS} starts" in job["problem"]["detail"]


def test_clips_end_when_the_service_hurries():
    threads = ComputeThreads(stream_threads=1, chunk_frames=8, clip_wait_s=1.0)
    threads.hurried = True

    async def begin() -> None:
        await anext(threads.in_chunks(1, lambda rows: iter([rows])))

    with pytest.raises(Draining, match="Connect again"):
        asyncio.run(begin())
    assert isinstance(Draining().__reduce__()[0](), Draining)
    threads.close()


def test_a_clip_that_others_keep_waiting_is_refused():
    async def second(chunk_frames: int) -> slice:
        """The second chunk of a clip, before which another clip has its turn for 1.2 s."""
        threads = ComputeThreads(stream_threads=1, chunk_frames=chunk_frames, clip_wait_s=0.05)
        chunks = threads.in_chunks(2 * chunk_frames, lambda rows: iter([rows]))
        try:
            await anext(chunks)
            async with threads.clip_turn:
                waiting = asyncio.ensure_future(anext(chunks))
                await asyncio.sleep(1.2)
            return await waiting
        finally:
            threads.close()

    async def both() -> None:
        assert await second(8) == slice(8, 16)  # one that has got more may wait longer
        with pytest.raises(Busy, match="1 frames of a clip after waiting 1 s"):
            await second(1)

    asyncio.run(both())


def test_a_stream_is_refused_while_the_service_drains(make_settings: Callable[..., Settings]):
    settings = make_settings()
    app = create_app(settings)
    with serve(app, settings) as url:
        app.state.drape.life.draining = True
        headers = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}
        headers |= {"Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Protocol": wire.SUBPROTOCOL}
        response = httpx.get(url + "/stream", headers=headers)
        app.state.drape.life.draining = False
        with raw_stream(url) as late:  # it had its handshake before
            app.state.drape.life.draining = True
            late.socket.send(json.dumps({"type": "open", "garment": "tube"}))
            assert json.loads(late.socket.recv(timeout=PATIENT_S))["kind"] == "Draining"
        assert response.status_code == 503 and response.json()["type"] == "urn:drape:Draining"
        assert httpx.get(url + "/readyz").status_code == 503


def test_the_limits_of_a_key_that_is_gone_are_none(make_settings: Callable[..., Settings]):
    access = Access(make_settings())
    assert access.client(None).name is None and access.client("former").name == "former"
