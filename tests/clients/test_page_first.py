"""What the page shows and asks first: a picture of the person, then cloth, then all else, and nothing twice."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest

from tests.architecture.repository import ROOT
from tests.clients.browser import Page, open_page

pytestmark = pytest.mark.browser

POSTER = ROOT / "clients/web/src/poster.webp"
POSTER_MOST_BYTES = 30_000
LATEST_MS = 10_000  # pictures wait no longer for cloth, as in clients/web/src/first.js: here it may be slow to move
LOADED = """JSON.stringify(performance.getEntriesByType("resource").map(
  ({ name, startTime, encodedBodySize, decodedBodySize }) => [name, startTime, encodedBodySize, decodedBodySize]))"""
# What moves while the page loads, in shares of the window, from before its first script on.
SHIFTS = """window.shifts = 0;
new PerformanceObserver((list) => { for (const { value } of list.getEntries()) window.shifts += value; })
  .observe({ type: "layout-shift", buffered: true });"""

# Whether and where the poster is before the first frame.
BEFORE = """(() => {
  document.body.dataset.frames = "0";
  const poster = document.getElementById("poster");
  return [getComputedStyle(poster).display, poster.getBoundingClientRect().toJSON()];
})()"""


@pytest.fixture(scope="module")
def page(live: str) -> Iterator[Page]:
    with open_page("about:blank", width=1350, height=940) as page:
        page.call("Page.addScriptToEvaluateOnNewDocument", source=SHIFTS)
        page.go(live + "/")
        page.wait_for("document.querySelector('#cards img[src]')?.complete")
        page.wait_for("performance.getEntriesByName('moving').length > 0")
        yield page


@pytest.fixture(scope="module")
def loaded(page: Page) -> list[tuple[str, float, int, int]]:
    """Of each file: address, when it was asked for, bytes that came and bytes that it has."""
    return json.loads(page.evaluate(LOADED))


def test_a_picture_of_the_person_stands_there_until_cloth_moves(page: Page):
    assert POSTER.stat().st_size < POSTER_MOST_BYTES
    shown = "getComputedStyle(document.getElementById('poster')).display"
    assert page.evaluate(shown) == "none"
    display, poster = page.evaluate(BEFORE)
    assert display == "block"
    box = "document.getElementById('{}').getBoundingClientRect().toJSON()"
    shelf, dock = (page.evaluate(box.format(one)) for one in ("shelf", "dock"))
    assert abs(poster["right"] - shelf["left"]) <= 1 and abs(poster["bottom"] + 12 - dock["top"]) <= 2


def test_pictures_of_garments_come_after_cloth_that_moves(page: Page, loaded: list):
    moving = page.evaluate("performance.getEntriesByName('moving')[0].startTime")
    pictures = [start for name, start, *_ in loaded if "preview.png" in name]
    assert pictures and min(pictures) >= min(moving, LATEST_MS)


def test_nothing_is_asked_twice(loaded: list):
    asked = Counter(name for name, *_ in loaded if "preview.png" not in name)
    assert {urlsplit(name).path for name in asked} >= {"/health", "/garments", "/garments/tube/mesh", "/motions/walk"}
    assert [name for name, often in asked.items() if often > 1] == []


def test_scripts_and_numbers_come_compressed(loaded: list):
    large = [(name, sent, whole) for name, _, sent, whole in loaded if whole > 2000]
    kept = [name for name, sent, whole in large if sent >= whole and not name.endswith((".webp", ".png"))]
    assert len(large) > 6 and not [name for name in kept if "preview.png" not in name]


def test_nothing_shifts_while_it_loads(page: Page):
    assert page.evaluate("window.shifts") < 0.005
    assert page.errors == []
