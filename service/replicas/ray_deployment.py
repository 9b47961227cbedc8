"""The deployment that ``service.ray_app`` serves: replicas of the application on Ray Serve.

Each replica is a process with the whole application. A stream stays with its replica. A replica that leaves hands its
streams over (``State.drain``), and their clients connect to the same address again. Only this folder and
``service.ray_app`` know Ray, and Ray is imported only where it is used.
"""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import threading
from typing import TYPE_CHECKING, Any

from fastapi import FastAPI

from drape.errors import InputError, Unavailable
from service.app import create_app
from service.compute.background import take_turns
from service.compute.drape_runtime import DrapeRuntime
from service.replicas import ray_router
from service.replicas.scaling import AGE, STREAMS, FrameAges, Load, Policy
from service.settings import Settings
from service.watch.logs import set_up
from service.watch.outputs import free_outputs
from service.watch.probes import Lifecycle
from service.watch.prometheus import Metrics

if TYPE_CHECKING:
    from ray.serve import Application  # pyright: ignore[reportMissingImports]

    from service.state import State

NAME = "drape"
GRACE_S = 15.0  # the time in which a leaving replica hands its streams over and answers its requests
UP_S, DOWN_S = 10.0, 120.0  # how long more, or fewer, replicas must be wanted before their number changes
LOOK_BACK_S = 15.0  # the time over which Ray averages the loads
LOOK_S = 2.0  # how often replicas look for each other's uploads
STORE_BYTES = 100 * 2**20  # the size of Ray's object store, which holds no frames


class Replica:
    """The service's application in a process of Ray, with the methods by which Ray reads its health and load."""

    def __init__(self, settings: Settings) -> None:
        self._deadline_s = settings.frame_deadline_s
        self._life, metrics = Lifecycle(stuck_s=settings.stuck_s), Metrics()
        runtime = DrapeRuntime(settings, metrics=metrics, at_once=False)
        self._app = create_app(settings, runtime=runtime, lifecycle=self._life)
        self._ages = FrameAges(metrics.frame_age)
        self._load = Load(0.0, 0)
        self._known: frozenset[str] = frozenset()
        self._tasks: set[asyncio.Task[None]] = set()
        self._settings = settings

    def __serve_build_asgi_app__(self) -> FastAPI:
        """Returns the application, whose lifespan Ray runs. Ray calls it once, in the event loop of the process."""
        set_up(self._settings.log_format)
        gc.collect()
        gc.freeze()  # service.__main__ says why
        take_turns()
        loop = asyncio.get_running_loop()
        ray_router.WATCHERS.append(lambda replicas: loop.call_soon_threadsafe(self._serving, replicas))
        self._begin(self._watch())
        return self._app

    def check_health(self) -> None:
        """Raises ``DrapeError`` where Ray should replace this process: its event loop or a job stands still, or it has
        drained and was not ended."""
        fault = self._life.unhealthy() or (self._life.unready() if self._life.draining else None)
        if fault is not None:
            raise fault

    def record_autoscaling_stats(self) -> dict[str, float]:
        """Returns the load of this replica as ``Policy`` reads it: the 99th percentile of its frames' ages [s], and its
        number of streams, by the names ``AGE`` and ``STREAMS``."""
        streams = self._state.streams.count if hasattr(self._app.state, "drape") else 0
        self._load = Load(self._ages.p99_s(), streams)
        return {AGE: self._load.age_s, STREAMS: float(streams)}

    async def here(self) -> int:
        """Returns the id of this process, as the answer to a call that only finds out whether the replica is there."""
        return os.getpid()

    @property
    def _state(self) -> State:
        return self._app.state.drape

    def _begin(self, work: Any) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _watch(self) -> None:
        """Calls any replica once through a handle of this process. From then on Ray tells it which replicas serve."""
        from ray import serve  # pyright: ignore[reportMissingImports]

        ours = serve.get_replica_context()
        await serve.get_deployment_handle(ours.deployment, ours.app_name).here.remote()

    def _serving(self, replicas: frozenset[str]) -> None:
        """Takes the ids of the ``replicas`` that serve from now on. Drains if this one is no longer among them; moves
        some streams to new ones if its frames are late."""
        from ray import serve  # pyright: ignore[reportMissingImports]

        mine, before = serve.get_replica_context().replica_tag, self._known
        self._known = replicas
        if mine in before and mine not in replicas:
            self._begin(self._state.drain())
        elif mine in before and self._load.age_s > self._deadline_s:
            self._state.streams.release(surplus(self._state.streams.count, before, replicas))


def surplus(streams: int, before: frozenset[str], now: frozenset[str]) -> int:
    """Returns how many of a replica's ``streams`` should move to new replicas: streams * new replicas / all replicas,
    rounded down. ``before`` and ``now`` are the ids of the replicas that served before and that serve now."""
    return streams * len(now - before) // len(now)


def check_replicas(settings: Settings, least: int, most: int) -> None:
    """Refuses (``InputError``) numbers of replicas that are below 1 or in the wrong order, and several replicas without
    a common secret, since they could not read each other's states and tickets."""
    if not 1 <= least <= most:
        got = f"{least} {most}"
        expected = "the least and the greatest number, from 1"
        raise InputError("--replicas", expected=expected, got=got, cure="Say --replicas 1 4.")
    if most > 1 and settings.ticket_secret is None:
        raise InputError(
            "DRAPE_TICKET_SECRET",
            expected=f"one secret for {most} replicas, which take over each other's streams and tickets",
            got="none",
            cure="Set it: export DRAPE_TICKET_SECRET=$(openssl rand -hex 32).",
        )


def application(settings: Settings, least: int, most: int) -> Application:
    """Returns the deployment of ``least`` to ``most`` replicas with ``settings``, for ``serve.run``. Refuses as
    ``check_replicas`` does, and (``Unavailable``) where Ray is missing."""
    check_replicas(settings, least, most)
    serve = _serve()
    # Other replicas may run on the same machine, so each takes only the processors that Ray gives it.
    streaming = settings.stream_threads or settings.threads
    from ray.serve.config import AutoscalingConfig, AutoscalingPolicy, RequestRouterConfig  # pyright: ignore

    policy = AutoscalingPolicy(policy_function=Policy, policy_kwargs={"deadline_s": settings.frame_deadline_s})
    deployment = serve.deployment(
        serve.ingress()(Replica),
        name=NAME,
        autoscaling_config=AutoscalingConfig(
            min_replicas=least,
            max_replicas=most,
            upscale_delay_s=UP_S,
            downscale_delay_s=DOWN_S,
            look_back_period_s=LOOK_BACK_S,
            policy=policy,
        ),
        # The application itself refuses what is too much, with a sentence; Ray would let it wait.
        max_ongoing_requests=settings.max_connections,
        request_router_config=RequestRouterConfig(request_router_class="service.replicas.ray_router:Router"),  # pyright: ignore
        ray_actor_options={"num_cpus": max(settings.threads, streaming), "num_gpus": int(settings.provider == "cuda")},
        graceful_shutdown_timeout_s=GRACE_S,
        graceful_shutdown_wait_loop_s=0.2,
        health_check_period_s=5.0,
        max_constructor_retry_count=2,
    )
    # Clients of moved streams connect to the same address again, so there is no successor by name.
    changes: dict[str, Any] = {"successor": "", "stream_threads": streaming}
    if most > 1 and "garments_look_s" not in settings.model_fields_set:
        changes["garments_look_s"] = LOOK_S
    return deployment.bind(settings.model_copy(update=changes))


def prepare_ray() -> None:
    """Sets the environment's variables that Ray reads when it is imported and when it starts a cluster from this
    process. Call it before Ray is imported."""
    os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"  # otherwise all of Ray's ports are open to the network
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # otherwise Ray reports every start to its makers
    os.environ.setdefault("RAY_worker_niceness", "0")  # otherwise all other processes go before frames


def start_ray(address: str | None = None, **more: Any) -> None:
    """Connects this process to the Ray cluster at ``address``; None starts a cluster on this machine. ``more`` are
    arguments of ``ray.init``."""
    import ray  # pyright: ignore[reportMissingImports]

    own: dict[str, Any] = {"include_dashboard": False, "object_store_memory": STORE_BYTES}
    ray.init(address=address, namespace=NAME, **(more if address else own | more))


def run_replicas(serving: Application, settings: Settings, address: str | None) -> None:
    serve, stopped = _serve(), threading.Event()
    import ray  # pyright: ignore[reportMissingImports]

    free_outputs(settings.log_format)
    start_ray(address)
    try:
        serve.start(http_options={"host": settings.host, "port": settings.port, "location": "HeadOnly"})
        serve.run(serving, name=NAME)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: stopped.set())
        print(f"drape on http://{settings.host}:{settings.port} with model {settings.model}, on Ray", flush=True)
        stopped.wait()
    except RuntimeError as error:  # Ray does not say why a replica does not start
        cure = "Start python -m service with the same settings: it says why."
        raise Unavailable("replicas", expected="replicas that start", got=str(error)[:300], cure=cure) from error
    finally:
        serve.shutdown()
        ray.shutdown()


def _serve() -> Any:
    """Returns the module ``ray.serve``. Refuses (``Unavailable``) where it is not installed."""
    try:
        from ray import serve  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError as error:
        raise Unavailable(
            "Ray",
            expected="the extra 'ray'",
            got=f"no {error.name}",
            cure="Install the service's wheel with [ray], in a clone: pip install -e 'service[ray]'.",
        ) from error
    return serve
