"""The web page at ``/``: the built files of clients/web, or a sentence where they are missing."""

from __future__ import annotations

from pathlib import Path

from fastapi.responses import HTMLResponse
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import Match, Mount
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from drape.errors import Unavailable
from service.errors import problem, rule_for

MISSING = Unavailable(
    "page",
    expected="its built files in clients/web/dist",
    got="none",
    cure="Run make page (needs Node.js), then reload.",
)


_METHODS = ("DELETE", "GET", "PATCH", "POST", "PUT")


class Page(StaticFiles):
    """Static files that may be built after the service has started."""

    def __init__(self, folder: Path) -> None:
        super().__init__(directory=folder, html=True, check_dir=False)
        self._index = folder / "index.html"

    async def check_config(self) -> None:
        """Nothing to check: the folder may appear later."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        if path == "." and not self._index.is_file():
            sentence = problem(MISSING)["detail"]
            html = (
                f"<!doctype html><title>drape</title><p>{sentence}</p><p>Programs can go on: <a href=/docs>/docs</a>."
            )
            return HTMLResponse(html, status_code=rule_for(MISSING).status)
        try:
            response = await super().get_response(path, scope)
        except HTTPException as error:
            if error.status_code == 404 and (methods := _methods(scope)):
                raise HTTPException(405, headers={"Allow": ", ".join(methods)}) from error
            raise
        # Names do not change with content: always ask, 304 is cheap.
        response.headers["Cache-Control"] = "no-cache"
        return response


def _methods(scope: Scope) -> list[str]:
    """The methods that this path has elsewhere: the page answers for every request that no route took whole."""
    routes = [route for route in scope["app"].routes if not isinstance(route, Mount)]
    asked = ({**scope, "method": method} for method in _METHODS)
    return [one["method"] for one in asked if any(route.matches(one)[0] is Match.FULL for route in routes)]
