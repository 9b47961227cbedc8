"""The application: ``create_app(settings)``."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI
from fastapi.middleware.cors import CORSMiddleware

from service import errors, garment_care, jets, openapi, preview, probes, reference, routes, stream
from service.access import ADMITTED, Access
from service.access import router as access_routes
from service.drapery import Drapery
from service.following import Follower
from service.handover import Handover
from service.jobs import Uploads
from service.lifecycle import Lifecycle
from service.limits import BodyLimit
from service.metrics import Metrics
from service.origins import Doors
from service.page import Page
from service.pasts import Pasts
from service.pictures import Previews
from service.piecework import Piecework
from service.request_log import RequestLog
from service.sessions import Streams
from service.settings import Settings, load_settings
from service.state import State
from service.tracing import make_tracing
from service.version import product_version


def create_app(
    settings: Settings | None = None, *, drapery: Drapery | None = None, lifecycle: Lifecycle | None = None
) -> FastAPI:
    """The service; ``drapery`` hands over what is already loaded, otherwise the start loads it."""
    settings = settings or load_settings()
    access = Access(settings)
    metrics = Metrics() if drapery is None else drapery.metrics
    tracing = make_tracing(settings.trace) if drapery is None else drapery.tracing
    life = lifecycle or Lifecycle(stuck_s=settings.stuck_s)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        loaded = drapery or Drapery(settings, metrics=metrics, tracing=tracing)
        piecework = Piecework()
        uploads, streams = Uploads(loaded, piecework, access), Streams(loaded, piecework)
        handover = Handover(loaded, access.tickets)
        following = Follower(loaded, streams, uploads)
        state = State(
            loaded, uploads, following, streams, piecework, access, handover, life, Pasts(settings), Previews()
        )
        app.state.drape = state
        state.uploads.start()
        state.streams.start()
        state.following.start()
        _watch(state, life)
        ticking = asyncio.create_task(life.tick(metrics.loop_lag.set), name="ticking")
        life.ready()
        try:
            yield
        finally:
            life.draining = True
            ticking.cancel()
            life.ended()
            await state.following.stop()
            await state.uploads.stop()
            await state.streams.stop()
            piecework.close()
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
    app.add_middleware(Doors, settings=settings)
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
    drapery, streams, uploads = state.drapery, state.streams, state.uploads
    drapery.metrics.watch(
        streams=lambda: streams.count,
        poses_waiting=lambda: streams.waiting,
        clips=lambda: state.clips,
        uploads_waiting=lambda: uploads.waiting,
        garments=lambda: len(drapery.garments.entries()),
    )
    life.works |= {"streams": lambda: streams.runs, "uploads": lambda: uploads.runs}
    life.works["following"] = lambda: state.following.runs
