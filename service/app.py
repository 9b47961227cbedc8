"""The application: ``create_app(settings)``."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI
from fastapi.middleware.cors import CORSMiddleware

from drape import __version__
from service.compute.drape_runtime import DrapeRuntime
from service.compute.processes import kill_all
from service.compute.threads import SlicedThread
from service.exact.clip_queue import ExactClips
from service.guard.access import Access
from service.guard.connection_times import EndsWithClient
from service.guard.limits import BodyLimit
from service.guard.origin_guard import OriginGuard
from service.http import (
    avatar_routes,
    clip_routes,
    exact_clips,
    fit_routes,
    fold_messages,
    garment_routes,
    info_routes,
    motion_routes,
    openapi,
    pages,
    problems,
    upload_routes,
)
from service.http.continuations import Continuations
from service.http.encodings import BriefJson
from service.http.kept import Kept
from service.replicas.handover import Handover
from service.settings import PAGE, Settings, load_settings
from service.state import ADMITTED, State
from service.stream import routes as stream_routes
from service.stream.workers import Streams
from service.uploads.jobs import Uploads
from service.uploads.motions import MotionFiles
from service.uploads.shared_folder import SharedFolder
from service.watch.logs import RequestLog
from service.watch.probes import Lifecycle
from service.watch.prometheus import Metrics
from service.watch.tracing import make_tracing
from service.watch.turns import LoopWatch
from service.watch.watchdog import ThreadLane, Watchdog

ROUTERS = (
    info_routes.router,
    garment_routes.router,
    avatar_routes.router,
    fit_routes.router,
    motion_routes.router,
    upload_routes.router,
    clip_routes.router,
)

MESHES_KEPT = 64  # the most meshes and motions in memory, of some 50 kB each


def create_app(
    settings: Settings | None = None, *, runtime: DrapeRuntime | None = None, lifecycle: Lifecycle | None = None
) -> FastAPI:
    """Returns the application with all routes and middleware. Its lifespan begins and ends what computes.

    ``runtime`` holds model, body and garments; where it is None the start loads them as ``settings`` say, which come
    from the environment by default. ``lifecycle`` is the one that probes read, a new one by default.
    """
    settings = settings or load_settings()
    access = Access(settings)
    metrics = Metrics() if runtime is None else runtime.metrics
    tracing = make_tracing(settings.trace) if runtime is None else runtime.tracing
    life = lifecycle or Lifecycle(stuck_s=settings.stuck_s)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        state = make_state(runtime or DrapeRuntime(settings, metrics=metrics, tracing=tracing), access, life)
        app.state.drape = state
        asyncio.get_running_loop().set_default_executor(ThreadLane("calls"))
        with (watch := LoopWatch(metrics)).watching():
            state.start(exact_clips.work_reader(state))
            ticking = asyncio.create_task(life.tick(watch.late), name="ticking")
            life.ready()
            preparing = asyncio.create_task(state.runtime.prepare_all(), name="preparing")
            watchdog = Watchdog(life, metrics, stuck_s=settings.stuck_s, kill=kill_all)
            try:
                yield
            finally:
                life.draining = True
                ticking.cancel()
                preparing.cancel()
                life.ended()
                await state.stop()
                watchdog.stop()

    app = FastAPI(
        title="drape",
        version=__version__,
        lifespan=lifespan,
        description="Drapes garments on moving bodies.",
        docs_url=None,  # FastAPI's own pages load their scripts from another host
        redoc_url=None,
    )
    problems.install_handlers(app)
    app.add_middleware(BriefJson)
    app.add_middleware(BodyLimit, settings=settings, lifecycle=life)
    if settings.allowed_origins:
        _allow_origins(app, settings)
    app.add_middleware(OriginGuard, settings=settings)
    app.add_middleware(EndsWithClient)
    app.add_middleware(RequestLog, metrics=metrics, tracing=tracing)
    app.include_router(info_routes.probe_routes(life, metrics))
    _add_routes(app, settings)
    return app


def _add_routes(app: FastAPI, settings: Settings) -> None:
    """Adds the routes that need a key, the stream, the API's reference and the page."""
    pages.install_reference(app)
    openapi.install_document(app)
    for router in ROUTERS:
        app.include_router(router, dependencies=ADMITTED, responses=openapi.responses(*openapi.EVERYWHERE))
    app.include_router(stream_routes.router)
    app.mount("/", pages.Page(PAGE))


def make_state(runtime: DrapeRuntime, access: Access, life: Lifecycle) -> State:
    """Returns the state of a service that drapes by ``runtime``. ``State.start`` begins its work."""
    sliced_thread = SlicedThread()
    uploads, streams = Uploads(runtime, sliced_thread, access), Streams(runtime, sliced_thread)
    return State(
        runtime=runtime,
        uploads=uploads,
        shared_folder=SharedFolder(runtime, streams, uploads),
        motion_files=MotionFiles(uploads, runtime.settings),
        streams=streams,
        sliced_thread=sliced_thread,
        access=access,
        handover=Handover(runtime, access.tickets),
        life=life,
        continuations=Continuations(),
        previews=Kept(garment_routes.PREVIEWS_KEPT),
        fold_messages=Kept(fold_messages.KEPT),
        meshes=Kept(MESHES_KEPT),
        exact=ExactClips(runtime),
    )


def _allow_origins(app: FastAPI, settings: Settings) -> None:
    """Lets pages of the ``allowed_origins`` read answers and their headers."""
    headers = [f"X-Drape-{name}" for name in ("Frames", "Vertices", "Origin", "Past")]
    app.add_middleware(
        CORSMiddleware,
        allow_origins=list(settings.allowed_origins),
        allow_methods=["*"],
        allow_headers=["*"],
        expose_headers=[*headers, "X-Request-Id", "Location"],
    )
