"""The application: ``create_app(settings)``."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI
from fastapi.middleware.cors import CORSMiddleware

from service import errors, jets, routes, stream
from service.drapery import Drapery
from service.jobs import Uploads
from service.limits import BodyLimit
from service.page import Page
from service.piecework import Piecework
from service.sessions import Streams
from service.settings import Settings, load_settings
from service.state import State
from service.version import product_version


def create_app(settings: Settings | None = None, *, drapery: Drapery | None = None) -> FastAPI:
    """The service; ``drapery`` hands over what is already loaded, otherwise the start loads it."""
    settings = settings or load_settings()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        loaded = drapery or Drapery(settings)
        piecework = Piecework()
        state = State(loaded, Uploads(loaded, piecework), Streams(loaded, piecework), piecework)
        app.state.drape = state
        state.uploads.start()
        state.streams.start()
        try:
            yield
        finally:
            await state.uploads.stop()
            await state.streams.stop()
            piecework.close()
            loaded.close()

    app = FastAPI(title="drape", version=product_version(), lifespan=lifespan, description="Garments on moving bodies.")
    errors.install(app)
    app.add_middleware(BodyLimit, settings=settings)
    if settings.allowed_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=list(settings.allowed_origins),
            allow_methods=["*"],
            allow_headers=["*"],
            expose_headers=["X-Drape-Frames", "X-Drape-Vertices", "X-Drape-Origin", "Location"],
        )
    app.include_router(routes.router)
    app.include_router(jets.router)
    app.include_router(stream.router)
    app.mount("/", Page(settings.page_dir))
    return app
