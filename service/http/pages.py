"""The pages of the service: the application at ``/``, and the reference of the REST interface at ``/docs``."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path

from fastapi import FastAPI
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import HTMLResponse
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.responses import FileResponse, Response
from starlette.routing import Match, Mount
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from drape.errors import NotFound, Unavailable
from service.errors import problem_of, rule_for
from service.http.encodings import accepts

PAGE_MISSING = Unavailable(
    "page", expected="its built files", got="none", cure="Run make page in a clone (it needs Node.js), then reload."
)
REFERENCE_PACKAGE = "fastapi_offline"  # it has the files of Swagger UI; its code is not used
REFERENCE_FILES = ("swagger-ui-bundle.js", "swagger-ui.css", "favicon.png")
REFERENCE_MISSING = Unavailable(
    "reference",
    expected="the package fastapi-offline, which has the files of Swagger UI",
    got="none",
    cure="Install the wheel with [serve]. Programs read /openapi.json.",
)
# Scripts, styles and workers are files of this service. A blob is a picture or a texture that the page has made.
POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self' 'wasm-unsafe-eval'",  # the page computes folds by WebAssembly
        "worker-src 'self'",
        "style-src 'self'",
        "img-src 'self' blob: data:",
        "connect-src 'self' blob: data: ws: wss:",  # a stream may go on at another process, with another address
        "frame-src 'self'",
        "form-action 'self'",
        "base-uri 'none'",
        "frame-ancestors 'self'",
    )
)
# The frame of a user's own tracker may run scripts of theirs. So it has an origin of its own and no network.
TRACKER = "tracker.html"
TRACKER_POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'unsafe-inline' blob: 'wasm-unsafe-eval'",
        "worker-src blob:",
        "img-src blob: data:",
        "connect-src blob: data:",
        "base-uri 'none'",
        "frame-ancestors 'self'",
        "sandbox allow-scripts",
    )
)
PACKED = {"br": ".br", "gzip": ".gz"}  # encodings and suffixes of files that the build has compressed, the best first
NAMED_BY_CONTENT, FOR_EVER = "part-", "public, max-age=31536000, immutable"  # such names hold a hash of the content
_METHODS = ("DELETE", "GET", "PATCH", "POST", "PUT")


class Page(StaticFiles):
    """The application that serves the static files in ``folder``, which may be built after the service has started."""

    def __init__(self, folder: Path) -> None:
        super().__init__(directory=folder, html=True, check_dir=False)
        self._index = folder / "index.html"

    async def check_config(self) -> None:
        """Does nothing, because the folder may appear after the start."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        if path == "." and not self._index.is_file():
            sentence = problem_of(PAGE_MISSING)["detail"]
            html = (
                f"<!doctype html><title>drape</title><p>{sentence}</p><p>Programs can go on: <a href=/docs>/docs</a>."
            )
            return HTMLResponse(html, status_code=rule_for(PAGE_MISSING).status)
        try:
            response = await super().get_response(path, scope)
        except HTTPException as error:
            if error.status_code == 404 and (methods := _methods(scope)):
                raise HTTPException(405, headers={"Allow": ", ".join(methods)}) from error
            raise
        # Browsers ask again for files whose names do not change with the content; 304 is cheap.
        response.headers["Cache-Control"] = FOR_EVER if path.startswith(NAMED_BY_CONTENT) else "no-cache"
        response.headers["Content-Security-Policy"] = TRACKER_POLICY if path == TRACKER else POLICY
        return response

    def file_response(
        self, full_path: str | os.PathLike[str], stat_result: os.stat_result, scope: Scope, status_code: int = 200
    ) -> Response:
        """Returns the response with the file ``full_path``: its compressed copy if the build has made one and the
        client accepts it."""
        accepted = Headers(scope=scope).get("accept-encoding", "")
        for encoding, suffix in PACKED.items():
            packed = f"{full_path}{suffix}"
            if accepts(accepted, encoding) and os.path.isfile(packed):
                response = super().file_response(packed, os.stat(packed), scope, status_code)
                response.headers["Content-Encoding"] = encoding
                break
        else:
            response = super().file_response(full_path, stat_result, scope, status_code)
        response.headers["Vary"] = "Accept-Encoding"
        return response


def _methods(scope: Scope) -> list[str]:
    """Returns the methods that routes of the service have for the path of ``scope``. A request with another method for
    that path comes to the page."""
    routes = [route for route in scope["app"].routes if not isinstance(route, Mount)]
    scopes = ({**scope, "method": method} for method in _METHODS)
    return [other["method"] for other in scopes if any(route.matches(other)[0] is Match.FULL for route in routes)]


def files_folder() -> Path | None:
    """Returns the folder with the files of Swagger UI; None if the package that has them is missing."""
    spec = find_spec(REFERENCE_PACKAGE)
    return None if spec is None or spec.origin is None else Path(spec.origin).parent / "static"


def install_reference(app: FastAPI) -> None:
    """Adds ``/docs`` and its files to ``app``, which must have been made with ``docs_url=None``."""
    folder = files_folder()

    async def docs() -> HTMLResponse:
        if folder is None:
            return HTMLResponse(
                f"<!doctype html><title>drape</title><p>{REFERENCE_MISSING}", rule_for(REFERENCE_MISSING).status
            )
        script, style, icon = (f"/docs/{name}" for name in REFERENCE_FILES)
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
            raise REFERENCE_MISSING
        if name not in REFERENCE_FILES:
            raise NotFound("file", expected=f"one of {', '.join(REFERENCE_FILES)}", got=name[:120], cure="See /docs.")
        return FileResponse(folder / name)

    app.add_api_route("/docs", docs, include_in_schema=False)
    app.add_api_route("/docs/{name}", file, include_in_schema=False, response_model=None)
