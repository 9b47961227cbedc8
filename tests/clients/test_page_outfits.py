"""The page on the shipped model: garments over each other, fewer corrections, jets instead of vertices.

The clip is one still pose, so that pictures do not depend on how fast a machine comes to them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from drape.artifacts import model_folder
from drape.inference.engine import Engine
from drape.inference.graph_names import PACKED
from drape.motion.samples import stretch
from service.app import create_app
from service.compute.drape_runtime import DrapeRuntime
from tests.clients.browser import Page, open_page
from tests.clients.test_page import set_control, share, stage
from tests.fixtures.garments import ship
from tests.fixtures.serving import serve
from tests.fixtures.streams import patient_streams

pytestmark = [pytest.mark.browser, pytest.mark.slow]

STILL_FRAME = 89  # arms up; neither garment comes through the other at a grazing angle
# What is sent is rounded by 0.2 mm at most (benchmarks/results/wire.json), a twentieth of a pixel. So an edge stays
# within one pixel of the page, which is blurred over two of the picture where a slow machine draws fewer of them, and
# over edges of 15 mm normals turn, and light changes, by at most 0.03 of 255 levels.
EDGE_PX = 2
SHADE, FEW = 8, 4  # of 255, and pixels

# Keeps what the page asks the stream for.
SPY = """(() => {
  window.openings = [];
  const send = WebSocket.prototype.send;
  WebSocket.prototype.send = function (data) {
    if (typeof data === "string") window.openings.push(data);
    return send.call(this, data);
  };
  return true;
})()"""


@pytest.fixture(scope="module")
def runtime(make_settings, tmp_path_factory) -> DrapeRuntime:
    folder = ship(tmp_path_factory.mktemp("three"), "shorts", "tank", "trousers")
    motions = tmp_path_factory.mktemp("motions")
    stretch().window(STILL_FRAME, 1).save(motions / "still.npz")
    folders = {"shipped_garments_dir": folder, "motions_dir": motions}
    # The graph, and not the engine: its parts that were opened tell what runs.
    graph = Engine(model_folder("onefit"), compiled=False)
    return DrapeRuntime(make_settings(model="onefit", max_layers=2, **folders), engine=graph)


@pytest.fixture(scope="module")
def page(runtime: DrapeRuntime) -> Iterator[Page]:
    with (
        patient_streams(),
        serve(create_app(runtime.settings, runtime=runtime), runtime.settings) as url,
        open_page(url + "/?garment=trousers,tank&clip=still", height=800) as page,
    ):
        page.wait_for("Number(document.body?.dataset.frames) >= 2")
        page.evaluate(SPY)
        set_control(page, "colour", "value", "#2f6fb0", "input")  # the page's own are greys
        set_control(page, "colour-1", "value", "#a3343a", "input")
        yield page


def worn(page: Page) -> list[str]:
    return page.evaluate("Array.from(document.querySelectorAll('#worn li'), (chip) => chip.dataset.garment)")


def last_opening(page: Page) -> dict:
    return json.loads(page.wait_for("window.openings.at(-1)"))


def click(page: Page, selector: str) -> None:
    page.evaluate(f"(() => {{ document.querySelector({selector!r}).click(); return true; }})()")


def click_that_opens(page: Page, selector: str) -> None:
    """Clicks and waits for the opening that follows: frames of the last one still come until then."""
    count = page.evaluate("window.openings.length")
    click(page, selector)
    page.wait_for(f"window.openings.length > {count}")


def more_frames(page: Page) -> None:
    """Waits until the stream answers the last opening with frames that are drawn."""
    page.wait_for(
        "document.body.dataset.state === 'open' && !document.querySelector('#message:not(.bad)')?.textContent"
    )
    frames = page.evaluate("Number(document.body.dataset.frames)")
    page.wait_for(f"Number(document.body.dataset.frames) >= {frames} + 2")


def test_both_garments_are_in_the_picture_in_their_colours(page: Page):
    assert worn(page) == ["trousers", "tank"]
    picture = stage(page.picture())
    assert share(picture, "b") > 0.005, "no trousers in their colour"
    assert share(picture, "r") > 0.005, "no tank in its colour"


def test_who_wears_all_that_a_service_drapes_is_told(page: Page):
    click(page, ".card[data-garment=shorts]")
    assert "2 garments" in page.wait_for("document.querySelector('#message.bad')?.textContent")
    assert worn(page) == ["trousers", "tank"]
    pressed = "Array.from(document.querySelectorAll('.card[aria-pressed=true]'), (card) => card.dataset.garment).sort()"
    assert page.evaluate(pressed) == ["tank", "trousers"]


def test_each_layer_has_its_own_colour(page: Page):
    set_control(page, "colour-1", "value", "#20a020", "input")
    set_control(page, "body", "checked", False, "change")  # its hair is brown
    more_frames(page)
    picture = stage(page.picture())
    assert share(picture, "g") > 0.005 and share(picture, "r") < 0.002 and share(picture, "b") > 0.005
    set_control(page, "body", "checked", True, "change")


def test_passes_are_chosen_and_the_service_runs_that_many(page: Page, runtime: DrapeRuntime):
    options = page.evaluate("Array.from(document.getElementById('passes').options, (option) => option.value)")
    assert options == ["", "4", "3", "2", "1", "0"] and not page.evaluate(
        "document.getElementById('passes-row').hidden"
    )
    for passes in (0, 2):
        set_control(page, "passes", "value", str(passes), "change")
        assert last_opening(page)["advanced"]["passes"] == passes
        more_frames(page)
        assert passes in {passes for graph, _, _, passes, _ in runtime.engine._opened if graph == PACKED}
    set_control(page, "passes", "value", "", "change")
    assert "passes" not in last_opening(page)["advanced"]


def outside(picture: np.ndarray, other: np.ndarray) -> np.ndarray:
    """How far [of 255] each pixel of ``picture`` lies outside of what ``other`` has within ``EDGE_PX`` of it."""
    size = (2 * EDGE_PX + 1, 2 * EDGE_PX + 1, 1)
    least, most = minimum_filter(other, size=size), maximum_filter(other, size=size)
    return np.maximum(least - picture, picture - most).max(axis=-1)


def drawn(page: Page, *, jets: bool) -> tuple[np.ndarray, float, int]:
    """The picture beside all controls, kB of a frame, and how many pixels wide the page draws."""
    set_control(page, "jets", "checked", jets, "change")
    page.wait_for(f"document.getElementById('left-row').hidden === {json.dumps(not jets)}")
    more_frames(page)
    size = page.evaluate("Number.parseFloat(document.getElementById('bytes').textContent)")
    return stage(page.picture()), size, page.evaluate("document.getElementById('view').width")


@pytest.mark.long
def test_jets_are_drawn_like_vertices_and_are_fewer_bytes(page: Page):
    """Without the push-out, of which jets carry a part, and without the body, which would show through at places.

    And without folds, which polynomials do not have.
    """
    set_control(page, "folds", "value", "0", "change")
    for control in ("push", "body"):
        set_control(page, control, "checked", False, "change")
    jets, of_jets, width = drawn(page, jets=True)
    assert last_opening(page)["geometry"] == "jets"
    vertices, of_vertices, width_after = drawn(page, jets=False)
    while width_after != width:  # a slow machine goes on with fewer pixels
        (jets, _, width), (vertices, _, width_after) = drawn(page, jets=True), drawn(page, jets=False)
    assert of_jets < 0.6 * of_vertices
    assert share(jets, "g") > 0.005 and share(jets, "b") > 0.005
    # Rounding of a vertex may move an edge within the cloth past the middle of a pixel.
    assert max((outside(*pair) > SHADE).sum() for pair in ((jets, vertices), (vertices, jets))) <= FEW
    for control in ("push", "body"):
        set_control(page, control, "checked", True, "change")
    set_control(page, "folds", "value", "", "change")


def test_a_quality_is_chosen_by_name_and_told(page: Page, runtime: DrapeRuntime):
    names = page.evaluate("Array.from(document.querySelectorAll('#tiers input'), (choice) => choice.value)")
    assert names == ["instant", "fast", "balanced", "accurate"]
    assert page.evaluate("document.querySelector('#tiers input:checked').value") == "balanced", "the service's default"
    for name in ("fast", "balanced"):
        click_that_opens(page, f"#tier-{name}")
        opening = last_opening(page)
        assert opening["tier"] == name and not {"passes", "folds"} & opening["advanced"].keys()
        page.wait_for(f"document.getElementById('quality').textContent.includes('{name}')")


@pytest.mark.long
def test_a_fabric_is_chosen_for_a_layer(page: Page):
    click(page, "#worn li:nth-child(2) .pick")
    assert page.evaluate("document.getElementById('fabric-of').textContent") == "Tank"
    click_that_opens(page, "[data-fabric=denim]")
    assert last_opening(page)["fabric"] == [None, "denim"]
    more_frames(page)
    click_that_opens(page, "[data-fabric=rib]")
    assert "fabric" not in last_opening(page), "its own again"
    more_frames(page)


def test_layers_change_places(page: Page):
    click_that_opens(page, "#further-in")
    assert worn(page) == last_opening(page)["garments"] == ["tank", "trousers"]
    more_frames(page)
    click_that_opens(page, "#further-out")
    assert worn(page) == ["trousers", "tank"]
    more_frames(page)


@pytest.mark.long
def test_garments_are_taken_off_and_put_on(page: Page):
    click_that_opens(page, "#remove")
    assert worn(page) == ["tank"]
    more_frames(page)
    opening = last_opening(page)
    assert opening["garment"] == "tank" and "garments" not in opening
    assert page.evaluate("document.getElementById('remove').disabled")
    click_that_opens(page, ".card[data-garment=shorts]")
    assert worn(page) == ["tank", "shorts"]
    more_frames(page)
    assert last_opening(page)["garments"] == ["tank", "shorts"]


def test_no_console_error_so_far(page: Page):
    assert page.errors == []
