"""The REST reference at ``/docs``: Swagger UI from this machine, no other host is asked."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from fastapi import FastAPI
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import HTMLResponse
from starlette.responses import FileResponse, Response

from drape.errors import NotFound, Unavailable
from service.errors import rule_for

PACKAGE = "fastapi_offline"  # carries the files of Swagger UI; its code is not used
FILES = ("swagger-ui-bundle.js", "swagger-ui.css", "favicon.png")
MISSING = Unavailable(
    "reference",
    expected="the package fastapi-offline, which carries Swagger UI",
    got="none",
    cure="Install the extra 'service'; /openapi.json says the same to programs.",
)


def files_folder() -> Path | None:
    """Where the files of Swagger UI lie; None where the package is missing."""
    spec = find_spec(PACKAGE)
    return None if spec is None or spec.origin is None else Path(spec.origin).parent / "static"


def install(app: FastAPI) -> None:
    """Adds ``/docs`` and its files to ``app``, which must have none of FastAPI's own."""
    folder = files_folder()

    async def docs() -> HTMLResponse:
        if folder is None:
            return HTMLResponse(f"<!doctype html><title>drape</title><p>{MISSING}", rule_for(MISSING).status)
        script, style, icon = (f"/docs/{name}" for name in FILES)
        return get_swagger_ui_html(
            openapi_url="/openapi.json",
            title="drape",
            swagger_js_url=script,
            swagger_css_url=style,
            swagger_favicon_url=icon,
            swagger_ui_parameters={"validatorUrl": None},
        )

    async def file(name: str) -> Response:
        if folder is None:
            raise MISSING
        if name not in FILES:
            raise NotFound("file", expected=f"one of {', '.join(FILES)}", got=name[:120], cure="See /docs.")
        return FileResponse(folder / name)

    app.add_api_route("/docs", docs, include_in_schema=False)
    app.add_api_route("/docs/{name}", file, include_in_schema=False, response_model=None)
