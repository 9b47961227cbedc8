"""The reference page asks no other host."""

from __future__ import annotations

import re

import httpx
import pytest

from service.http import reference


def test_the_reference_and_its_files_come_from_this_service(api: httpx.Client):
    page = api.get("/docs")
    assert page.status_code == 200 and "/openapi.json" in page.text
    assert re.findall(r"https?://", page.text) == []
    for name in reference.FILES:
        assert f"/docs/{name}" in page.text
        assert api.get(f"/docs/{name}").status_code == 200
    assert api.get("/docs/other.js").status_code == 404
    assert api.get("/redoc").status_code == 404


def test_without_the_package_a_sentence_says_so(make_settings, monkeypatch: pytest.MonkeyPatch):
    from service.app import create_app
    from tests.fixtures.serving import serve

    monkeypatch.setattr(reference, "PACKAGE", "no_such_package")
    assert reference.files_folder() is None
    settings = make_settings()
    with serve(create_app(settings), settings) as url:
        for path in ("/docs", f"/docs/{reference.FILES[0]}"):
            response = httpx.get(url + path)
            assert response.status_code == 503 and "fastapi-offline" in response.text
