"""The web page in headless Chromium: a garment on a body, moving, without a console error."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.architecture.repository import ROOT
from tests.clients.browser import Page, open_page

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def page(live: str) -> Iterator[Page]:
    with open_page(live + "/?garment=tube&clip=reach") as page:
        page.wait_for("Number(document.body?.dataset.frames) >= 3")
        set_control(page, "colour", "value", "#2f6fb0", "input")  # the page's own are greys
        yield page


def share(picture: np.ndarray, colour: str) -> float:
    """Share of the picture, beside the panel, in which ``colour`` (a channel) stands out."""
    scene = picture[:, 300:]
    channel = "rgb".index(colour)
    others = [scene[..., i] for i in range(3) if i != channel]
    return float((scene[..., channel] > 1.35 * np.maximum(*others) + 8).mean())


def set_control(page: Page, element: str, name: str, value: object, event: str) -> None:
    """Sets a property of a control and tells the page, as a user's hand would."""
    page.evaluate(
        f"""(() => {{
        const control = document.getElementById({json.dumps(element)});
        control[{json.dumps(name)}] = {json.dumps(value)};
        control.dispatchEvent(new Event({json.dumps(event)}));
        }})()"""
    )


def test_it_opens_on_garments_that_are_shipped():
    source = (ROOT / "clients/web/src/main.js").read_text(encoding="utf-8")
    worn = source.partition('const WORN = "')[2].partition('"')[0].split(",")
    assert len(worn) == 2 and all(list((ROOT / "assets/garments").glob(f"{name}-*.npz")) for name in worn)


def test_it_draws_with_webgl_and_says_so(page: Page):
    name = page.evaluate(
        """(() => { const gl = document.createElement("canvas").getContext("webgl2");
        return gl && gl.getParameter(gl.getExtension("WEBGL_debug_renderer_info").UNMASKED_RENDERER_WEBGL); })()"""
    )
    assert name
    assert page.evaluate("document.body.dataset.state") == "open"


def test_the_garment_and_the_body_are_in_the_picture(page: Page):
    picture = page.picture()
    assert picture.std() > 10.0, "the page is blank"
    assert 0.005 < share(picture, "b") < 0.3, "no garment in its colour"
    red, green, blue = (picture[:, 300:, i] for i in range(3))
    skin = (red > green) & (green > blue) & (red - blue > 35)
    assert skin.mean() > 0.01, "no body"


def test_the_picture_moves(page: Page):
    before = page.picture()[:, 300:]
    frames = page.evaluate("Number(document.body.dataset.frames)")
    page.wait_for(f"Number(document.body.dataset.frames) > {frames} + 5")
    after = page.picture()[:, 300:]
    assert (np.abs(after - before).max(axis=-1) > 30).mean() > 0.001


def test_frame_rate_and_age_are_shown(page: Page):
    page.wait_for("Number(document.getElementById('fps').textContent) > 0")
    assert page.evaluate("document.getElementById('age').textContent").endswith(" ms")
    assert page.evaluate("document.getElementById('pushed').textContent").endswith(" %")


def test_the_controls_do_what_they_say(page: Page):
    set_control(page, "colour", "value", "#c02020", "input")
    set_control(page, "clip", "value", "squat", "change")
    set_control(page, "push", "checked", False, "change")
    page.wait_for("document.getElementById('pushed').textContent === 'off'")
    picture = page.picture()
    assert share(picture, "b") < 0.001
    assert share(picture, "r") > 0.005


def test_the_finer_mesh_is_fetched_with_the_frames_that_have_it(page: Page):
    fetched = "performance.getEntriesByType('resource').map((entry) => entry.name).join(' ')"
    assert "/garments/tube/mesh?resolution=fine" not in page.evaluate(fetched)
    set_control(page, "resolution", "value", "fine", "change")
    page.wait_for(f"{fetched}.includes('/garments/tube/mesh?resolution=fine')")
    frames = page.evaluate("Number(document.body.dataset.frames)")
    page.wait_for(f"Number(document.body.dataset.frames) > {frames} + 2")
    assert page.evaluate("document.body.dataset.state") == "open"
    set_control(page, "resolution", "value", "", "change")


def test_a_refused_upload_is_told_in_words(page: Page, tmp_path: Path):
    noise = tmp_path / "noise.obj"
    noise.write_bytes(b"nothing that is a mesh\n")
    page.choose_file("#file", noise)
    page.evaluate("(() => { document.getElementById('upload').click(); return true; })()")
    said = page.wait_for("document.querySelector('#message.bad')?.textContent")
    assert "noise" in said and "expected" in said
    frames = page.evaluate("Number(document.body.dataset.frames)")
    page.wait_for(f"Number(document.body.dataset.frames) > {frames}")


def test_no_console_error_so_far(page: Page):
    assert page.errors == []
