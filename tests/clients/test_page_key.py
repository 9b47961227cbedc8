"""The web page of a service with keys: it asks for one, and streams with a ticket."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from service.guard.key_file import key_digest
from service.settings import Settings
from tests.clients.browser import open_page
from tests.fixtures.serving import served

pytestmark = pytest.mark.browser


def test_the_page_asks_for_a_key_and_streams_with_it(make_settings: Callable[..., Settings], tmp_path: Path):
    file = tmp_path / "keys.json"
    file.write_text(json.dumps({"shop": {"sha256": key_digest("drape_key"), "rate": 100}}))
    settings = make_settings(keys_file=file)
    with served(settings) as url, open_page(url + "/?garment=tube&clip=reach") as page:
        page.wait_for("document.body?.dataset.state === 'locked' && !document.getElementById('door').hidden")
        for key, until in (("wrong", "'locked'"), ("drape_key", "'open' && Number(document.body.dataset.frames) >= 3")):
            entered = f"window.stale = true; document.getElementById('key').value = {key!r};"
            # In a while: an answer from a page that is being left may be lost.
            page.evaluate(f"{entered} setTimeout(() => document.getElementById('door').requestSubmit(), 50); true")
            kept = f"!window.stale && sessionStorage.getItem('drape-key') === {key!r}"  # on the page that comes then
            page.wait_for(f"{kept} && document.body?.dataset.state === {until}")
        assert page.evaluate("document.getElementById('door').hidden") is True
