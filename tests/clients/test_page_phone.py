"""The page on a telephone: nothing lies over anything, and nobody is kept out."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.clients.browser import Page, open_page, violations
from tests.clients.test_page import click

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def phone(live: str) -> Iterator[Page]:
    with open_page("about:blank", width=390, height=844) as page:
        page.phone(390, 844)
        page.media(scheme="light", reduced_motion=True)
        page.go(live + "/?garment=tube&clip=reach")
        page.wait_for("Number(document.body?.dataset.frames) >= 2")
        yield page


def test_on_a_phone_nothing_lies_over_anything(phone: Page):
    assert phone.evaluate("document.documentElement.scrollWidth") == 390
    for change in ("", "sheet"):
        if change:
            click(phone, change)
        boxes = phone.evaluate(
            """Array.from(document.querySelectorAll("h1, #worn, #tools, #quality-bar, #play-bar, #shelf"), (one) => {
            const { left, right, top, bottom } = one.getBoundingClientRect();
            return [one.id || one.localName, left, right, top, bottom]; })"""
        )
        assert len(boxes) == 6
        for place, (name, left, right, top, bottom) in enumerate(boxes):
            assert left >= 0 and right <= 390 and top >= 0 and bottom <= 845, name
            for other, *sides in boxes[place + 1 :]:
                apart = right <= sides[0] or sides[1] <= left or bottom <= sides[2] or sides[3] <= top
                assert apart, f"{name} over {other}"
    click(phone, "sheet")


def test_who_asks_for_less_motion_begins_with_a_still(phone: Page):
    assert phone.evaluate("document.getElementById('play').getAttribute('aria-label')") == "Play"
    assert phone.evaluate("Number(document.getElementById('scrub').value)") == 0.0


def test_nobody_is_kept_out_on_a_phone(phone: Page):
    assert violations(phone) == []
    click(phone, "numbers")
    assert violations(phone) == []
    click(phone, "numbers-close")
    click(phone, "help-open")
    assert violations(phone) == []
    assert phone.errors == []
