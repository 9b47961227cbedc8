"""The application: ``create_app(settings)``."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI
from fastapi.middleware.cors import CORSMiddleware

from service import errors
from service.compute.drape_runtime import DrapeRuntime
from service.compute.sliced_thread import SlicedThread
from service.guard.access import ADMITTED, Access
from service.guard.access import router as access_routes
from service.guard.limits import BodyLimit
from service.guard.origin_guard import OriginGuard
from service.http import garment_care, jets, openapi, preview, reference, routes
from service.http.continuations import Continuations
from service.http.page import Page
from service.http.pictures import Previews
from service.replicas.handover import Handover
from service.settings import Settings, load_settings
from service.state import State
from service.stream import routes as stream
from service.stream.sessions import Streams
from service.uploads.jobs import Uploads
from service.uploads.shared_folder import SharedFolder
from service.version import product_version
from service.watch import probes
from service.watch.lifecycle import Lifecycle
from service.watch.metrics import Metrics
from service.watch.request_log import RequestLog
from service.watch.tracing import make_tracing


def create_app(
    settings: Settings | None = None, *, runtime: DrapeRuntime | None = None, lifecycle: Lifecycle | None = None
) -> FastAPI:
    """The service; ``runtime`` hands over what is already loaded, otherwise the start loads it."""
    settings = settings or load_settings()
    access = Access(settings)
    metrics = Metrics() if runtime is None else runtime.metrics
    tracing = make_tracing(settings.trace) if runtime is None else runtime.tracing
    life = lifecycle or Lifecycle(stuck_s=settings.stuck_s)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        loaded = runtime or DrapeRuntime(settings, metrics=metrics, tracing=tracing)
        sliced_thread = SlicedThread()
        uploads, streams = Uploads(loaded, sliced_thread, access), Streams(loaded, sliced_thread)
        handover = Handover(loaded, access.tickets)
        shared_folder = SharedFolder(loaded, streams, uploads)
        state = State(
            loaded,
            uploads,
            shared_folder,
            streams,
            sliced_thread,
            access,
            handover,
            life,
            Continuations(settings),
            Previews(),
        )
        app.state.drape = state
        state.uploads.start()
        state.streams.start()
        state.shared_folder.start()
        _watch(state, life)
        ticking = asyncio.create_task(life.tick(metrics.loop_lag.set), name="ticking")
        life.ready()
        try:
            yield
        finally:
            life.draining = True
            ticking.cancel()
            life.ended()
            await state.shared_folder.stop()
            await state.uploads.stop()
            await state.streams.stop()
            sliced_thread.close()
            loaded.close()

    app = FastAPI(
        title="drape",
        version=product_version(),
        lifespan=lifespan,
        description="Garments on moving bodies.",
        docs_url=None,  # those of FastAPI load their scripts from another host
        redoc_url=None,
    )
    errors.install(app)
    app.add_middleware(BodyLimit, settings=settings, lifecycle=life)
    if settings.allowed_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=list(settings.allowed_origins),
            allow_methods=["*"],
            allow_headers=["*"],
            expose_headers=[
                *(f"X-Drape-{name}" for name in ("Frames", "Vertices", "Origin", "Past")),
                "X-Request-Id",
                "Location",
            ],
        )
    app.add_middleware(OriginGuard, settings=settings)
    app.add_middleware(RequestLog, metrics=metrics, tracing=tracing)
    probes.install(app, life, metrics, ADMITTED)
    reference.install(app)
    openapi.install(app)
    for router in (routes.router, jets.router, preview.router, garment_care.router, access_routes):
        app.include_router(router, dependencies=ADMITTED, responses=openapi.responses(*openapi.EVERYWHERE))
    app.include_router(stream.router)
    app.mount("/", Page(settings.page_dir))
    return app


def _watch(state: State, life: Lifecycle) -> None:
    """Lets the metrics and the readiness look at what runs."""
    runtime, streams, uploads = state.runtime, state.streams, state.uploads
    runtime.metrics.watch(
        streams=lambda: streams.count,
        poses_waiting=lambda: streams.waiting,
        clips=lambda: state.clips,
        uploads_waiting=lambda: uploads.waiting,
        garments=lambda: len(runtime.garments.entries()),
    )
    life.works |= {"streams": lambda: streams.runs, "uploads": lambda: uploads.runs}
    life.works["shared folder"] = lambda: state.shared_folder.runs
