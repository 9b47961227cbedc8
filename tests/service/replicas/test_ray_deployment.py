"""The service on Ray: replicas that scale, drain and are replaced."""

from __future__ import annotations

import asyncio
import importlib.util
import inspect
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clients.stream import DrapeStream
from drape.errors import DrapeError, InputError, Unavailable
from drape.garment.cache import Garment
from service import ray_app
from service.replicas import ray_deployment, ray_router
from service.replicas.scaling import AGE, STREAMS, WINDOW_S, FrameAges, Load, Policy, wanted_replicas
from service.settings import Settings
from service.watch.prometheus import Metrics
from tests.architecture.repository import ROOT
from tests.fixtures.meshes import garment_obj
from tests.fixtures.patience import ended_job
from tests.fixtures.tiny_model import TINY_DYNAMIC

with_ray = pytest.mark.skipif(
    importlib.util.find_spec("ray") is None, reason="Ray is not installed: pip install -e 'service[ray]'."
)
BACK_S = 20.0  # in which a killed stream must be back, on a busy machine


@pytest.mark.parametrize("replicas", [(0, 1), (2, 1), (-1, -1)])
def test_numbers_of_replicas_are_checked(make_settings: Callable[..., Settings], replicas: tuple[int, int]):
    with pytest.raises(InputError, match="--replicas 1 4"):
        ray_deployment.check_replicas(make_settings(ticket_secret="one"), *replicas)


def test_several_replicas_need_one_secret(make_settings: Callable[..., Settings]):
    ray_deployment.check_replicas(make_settings(), 1, 1)
    with pytest.raises(InputError, match="openssl rand -hex 32"):
        ray_deployment.check_replicas(make_settings(), 1, 2)
    ray_deployment.check_replicas(make_settings(ticket_secret="one"), 1, 2)


def test_rays_own_command_takes_the_numbers_too(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("DRAPE_TICKET_SECRET", raising=False)
    with pytest.raises(InputError, match="one secret for 3 replicas"):
        ray_app.app({"least": "2", "most": "3"})


def test_without_ray_the_command_says_what_to_install(monkeypatch: pytest.MonkeyPatch, capsys):
    for name in ("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "RAY_USAGE_STATS_ENABLED", "RAY_worker_niceness"):
        monkeypatch.setenv(name, "0")  # so that what the command sets goes again
    monkeypatch.setitem(sys.modules, "ray", None)
    assert ray_app.main(["--port", "0"]) == 2
    assert "pip install -e 'service[ray]'" in capsys.readouterr().err
    assert ray_app.main(["--replicas", "3", "2"]) == 2
    assert ray_app.main(["--host", "0.0.0.0"]) == 2


def test_new_replicas_get_their_share():
    ours = frozenset("ab")
    assert ray_deployment.surplus(6, ours, frozenset("abc")) == 2
    assert ray_deployment.surplus(6, ours, frozenset("bc")) == 3
    assert ray_deployment.surplus(6, ours, ours) == ray_deployment.surplus(6, ours, frozenset("a")) == 0


def test_the_router_has_one_name():
    with pytest.raises(AttributeError, match="Routers"):
        _ = ray_router.Routers


def test_a_replica_tells_its_load_and_its_health(make_settings: Callable[..., Settings]):
    replica = ray_deployment.Replica(make_settings())
    assert replica.record_autoscaling_stats() == {AGE: 0.0, STREAMS: 0.0}
    replica.check_health()
    replica._life.draining = True  # Ray asks only replicas that it keeps
    with pytest.raises(Unavailable, match="one that drains"):
        replica.check_health()


@with_ray
@pytest.mark.parametrize(
    ("ages", "streams", "target", "expected"),
    [
        ([0.2], [3.0], 1, 2),
        ([0.2], [3.0], 2, 2),  # the second still starts
        ([0.0, 0.0], [0.0, 0.0], 2, 1),
        ([], [], 1, 1),  # nothing told yet
    ],
)
def test_the_policy_reads_what_ray_has_gathered(ages: list[float], streams: list[float], target: int, expected: int):
    ray_deployment.prepare_ray()
    from ray.serve.config import AutoscalingContext  # pyright: ignore[reportMissingImports]

    names = [f"replica{place}" for place in range(len(ages))]
    about: dict[str, Any] = {name: None for name in inspect.signature(AutoscalingContext).parameters}
    about |= {"target_num_replicas": target, "current_num_replicas": len(ages), "running_replicas": names}
    about["aggregated_metrics"] = {
        AGE: dict(zip(names, ages, strict=True)),
        STREAMS: dict(zip(names, streams, strict=True)),
    }
    assert Policy(0.066)(AutoscalingContext(**about)) == (expected, {})


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


@pytest.fixture(scope="module")
def ray_settings(make_settings: Callable[..., Settings]) -> Settings:
    return make_settings(model=TINY_DYNAMIC, folds=2, ticket_secret=secrets.token_hex(16), port=free_port())


@pytest.fixture(scope="module")
def url(ray_settings: Settings) -> Iterator[str]:
    """The address of two replicas on a cluster of Ray of its own."""
    ray_deployment.prepare_ray()
    os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))  # otherwise Ray writes one into the home folder
    folder = tempfile.mkdtemp(prefix="r", dir="/tmp")  # a socket's path may have 107 characters
    import ray  # pyright: ignore[reportMissingImports]
    from ray import serve  # pyright: ignore[reportMissingImports]

    ray_deployment.start_ray(num_cpus=2, _temp_dir=folder, log_to_driver=False)
    try:
        serve.start(http_options={"host": "127.0.0.1", "port": ray_settings.port, "location": "HeadOnly"})
        serve.run(ray_deployment.application(ray_settings, 2, 2), name=ray_deployment.NAME)
        yield f"http://127.0.0.1:{ray_settings.port}"
    finally:
        serve.shutdown()
        ray.shutdown()
        shutil.rmtree(folder, ignore_errors=True)


def replicas() -> list[int]:
    """The processes of this cluster's replicas."""
    import ray  # pyright: ignore[reportMissingImports]

    session = ray.get_runtime_context().get_session_name()
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if (folder / "cmdline").read_bytes().startswith(b"ray::ServeReplica"):
                fathers = (folder / "stat").read_text().rpartition(")")[2].split()[1]
                if session.encode() in (Path("/proc") / fathers / "cmdline").read_bytes():
                    found.append(int(folder.name))
        except OSError:
            continue  # it has just ended
    return found


class Wearer:
    """A client that sends poses, and opens its stream again where that is lost; ``said`` is what it lived through."""

    def __init__(self, url: str, first: DrapeStream) -> None:
        self._url, self.stream, self.frames, self.lost = url, first, 0, 0
        self.longest_s = 0.0  # between two frames
        self._wanted = True

    async def run(self) -> None:
        pose, last_s = np.zeros((24, 3)), time.monotonic()
        while self._wanted:
            try:
                pose[16, 2] = 0.3 * np.sin(self.frames / 10.0)
                await self.stream.send(pose)
                await asyncio.wait_for(self.stream.receive(), BACK_S)
            except DrapeError:
                self.lost += 1
                await self._again()
                continue
            self.frames, now_s = self.frames + 1, time.monotonic()
            self.longest_s, last_s = max(self.longest_s, now_s - last_s), now_s
            await asyncio.sleep(0.03)
        await self.stream.close()

    async def _again(self) -> None:
        until_s = time.monotonic() + BACK_S
        while True:
            try:
                self.stream = await DrapeStream.open(self._url, "tube")
                return
            except DrapeError:
                assert time.monotonic() < until_s
                await asyncio.sleep(0.05)

    async def goes_on(self, seen: int) -> None:
        """Waits until it has more than ``seen`` frames."""
        until_s = time.monotonic() + BACK_S
        while self.frames <= seen:
            assert time.monotonic() < until_s, "the stream stands still"
            await asyncio.sleep(0.02)

    def leave(self) -> None:
        self._wanted = False


def wear(url: str, meanwhile: Callable[[], Awaitable[Any]]) -> list[Wearer]:
    """Four streams, opened one after the other, which get frames before, during and after ``meanwhile``."""

    async def talk() -> list[Wearer]:
        wearers = [Wearer(url, await DrapeStream.open(url, "tube")) for _ in range(4)]
        tasks = [asyncio.create_task(one.run()) for one in wearers]
        try:
            for one in wearers:
                await one.goes_on(5)
            await meanwhile()
            for one in wearers:
                await one.goes_on(one.frames + 5)
        finally:
            for one in wearers:
                one.leave()
            await asyncio.gather(*tasks)
        return wearers

    return asyncio.run(talk())


async def until(true: Callable[[], bool], limit_s: float) -> None:
    """Waits until something is ``true``."""
    until_s = time.monotonic() + limit_s
    while not true():
        assert time.monotonic() < until_s
        await asyncio.sleep(0.1)


@with_ray
@pytest.mark.slow
def test_requests_and_refusals_are_those_of_the_service(url: str):
    with httpx.Client(base_url=url, timeout=30.0) as client:
        assert client.get("/readyz").json() == {"status": "ok"}
        assert [garment["id"] for garment in client.get("/garments").json()] == ["tube"]
        answer = client.post("/drape", json={"garment": "tube", "poses": np.zeros((3, 24, 3)).tolist()})
        assert answer.status_code == 200 and answer.headers["X-Drape-Frames"] == "3"
        refused = client.get("/garments/nothing")
        assert refused.status_code == 404 and refused.json()["type"] == "urn:drape:NotFound"
    with pytest.raises(DrapeError, match="one of: tube"):
        asyncio.run(DrapeStream.open(url, "nothing"))


@with_ray
@pytest.mark.slow
def test_a_killed_replica_costs_its_streams_a_moment_and_no_garment(url: str, tube: Garment, ray_settings: Settings):
    with httpx.Client(base_url=url, timeout=30.0) as client:
        job = client.post("/garments", params={"name": "kept.obj", "avatar": "standard"}, content=garment_obj(tube))
        said = ended_job(client, job)  # whichever of the two is asked
        assert said["state"] == "done", said
        asked = {"garment": said["garment"], "poses": np.zeros((1, 24, 3)).tolist()}
        assert {client.post("/drape", json=asked).status_code for _ in range(16)} == {200}
    (stored,) = ray_settings.garments_dir.glob("*.npz")
    before, statuses = replicas(), []
    assert len(before) == 2

    async def killed() -> None:
        os.kill(before[0], signal.SIGKILL)
        async with httpx.AsyncClient(base_url=url, timeout=30.0) as client:
            for _ in range(20):
                statuses.append((await client.get("/garments")).status_code)
                await asyncio.sleep(0.05)

        def healed() -> bool:
            return len(now := replicas()) == 2 and before[0] not in now

        await until(healed, 60.0)

    wearers = wear(url, killed)
    assert sorted(one.lost for one in wearers) == [0, 0, 1, 1]  # two streams on each
    assert statuses.count(200) >= 18  # what was under way at that moment may be lost
    assert stored.is_file()
    found: set[str] = set()
    until_s = time.monotonic() + 60.0
    while "kept" not in found:  # the new replica reads it from the folder
        assert time.monotonic() < until_s
        found = {garment["id"] for garment in httpx.get(url + "/garments", timeout=30.0).json()}


@with_ray
@pytest.mark.slow
def test_streams_move_when_all_replicas_are_replaced_and_none_is_lost(url: str, ray_settings: Settings):
    from ray import serve  # pyright: ignore[reportMissingImports]

    before = replicas()

    async def replaced() -> None:
        await asyncio.to_thread(serve.run, ray_deployment.application(ray_settings, 2, 2), name=ray_deployment.NAME)
        await until(lambda: len(now := replicas()) == 2 and not {*now} & {*before}, 60.0)

    wearers = wear(url, replaced)
    assert [one.lost for one in wearers] == [0, 0, 0, 0]
    assert all(one.stream.moves and one.stream.about["resumed"] for one in wearers)


@with_ray
@pytest.mark.slow
def test_replicas_that_cannot_start_are_told_of(ray_settings: Settings):
    environment = {**os.environ, "DRAPE_MODEL": "nothing", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
    command = [sys.executable, "-m", "service.ray_app", "--port", str(free_port())]
    ended = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=180)
    assert ended.returncode == 2
    assert "python -m service with the same settings" in ended.stderr


DEADLINE_S = 0.066
loads = st.lists(
    st.builds(Load, age_s=st.floats(0.0, 2.0), streams=st.integers(0, 8)).filter(
        lambda load: load.streams > 0 or load.age_s == 0.0
    ),
    min_size=1,
    max_size=8,
).map(lambda found: {str(place): load for place, load in enumerate(found)})


def test_ages_are_those_of_the_last_seconds():
    metrics = Metrics()
    ages = FrameAges(metrics.frame_age)
    assert ages.p99_s(0.0) == 0.0
    for _ in range(1000):
        metrics.count_sent(0.02, DEADLINE_S)
    calm = ages.p99_s(1.0)
    assert 0.016 < calm <= 0.033
    for _ in range(20):
        metrics.count_sent(0.15, DEADLINE_S)
    assert 0.1 < ages.p99_s(2.0) <= 0.2
    assert ages.p99_s(2.0 + WINDOW_S) == 0.0
    metrics.count_sent(0.02, DEADLINE_S)
    assert 0.016 < ages.p99_s(3.0 + WINDOW_S) <= 0.033
    metrics.count_sent(100.0, DEADLINE_S)
    assert ages.p99_s(4.0 + WINDOW_S) == 60.0


@pytest.mark.parametrize(
    ("replicas", "expected"),
    [
        ([Load(0.02, 1)], 1),
        ([Load(0.2, 3)], 2),
        ([Load(0.2, 1)], 1),  # nothing that another replica could take
        ([Load(0.2, 3), Load(0.02, 1)], 3),
        ([Load(0.05, 2), Load(0.02, 1)], 2),
        ([Load(0.03, 1), Load(0.0, 0)], 1),
        ([Load(0.03, 1), Load(0.03, 1)], 2),
        ([Load(0.02, 1), Load(0.02, 1)], 1),
        ([Load(0.2, 1), Load(0.0, 0)], 1),
        ([Load(0.0, 0)] * 3, 2),
    ],
)
def test_replicas_that_are_wanted(replicas: list[Load], expected: int):
    assert wanted_replicas({str(place): load for place, load in enumerate(replicas)}, DEADLINE_S) == expected


@given(loads)
def test_a_replica_that_went_is_not_wanted_again_at_once(found: dict[str, Load]):
    number = wanted_replicas(found, DEADLINE_S)
    assert abs(number - len(found)) <= 1 and number >= 1
    if number >= len(found):
        return
    gone = min(found, key=lambda name: found[name].streams)
    left = {name: load for name, load in found.items() if name != gone}
    spread = Load(sum(load.age_s for load in found.values()) / number, 8)
    after = left if found[gone].streams == 0 else dict.fromkeys(left, spread)
    assert wanted_replicas(after, DEADLINE_S) <= number
