"""Characters on the page: in its garments, and in clothes of their own."""

from __future__ import annotations

import base64
from pathlib import Path

import pytest

from drape.body.model import BodyModel
from drape.catalog import find_garments, open_garment
from tests.clients.browser import Page
from tests.clients.test_page import click, more_frames, page, share, stage
from tests.fixtures.characters import ARMS_DOWN_RAD, character
from tests.fixtures.dressed_characters import Worn, dressed_character, dressed_parts
from tests.fixtures.glb_reader import Reader
from tests.fixtures.patience import PATIENT_S

__all__ = ["page"]
pytestmark = pytest.mark.browser


KEEP = """(() => {
  const was = URL.createObjectURL;
  URL.createObjectURL = (blob) => { window.savedFile = blob; return was.call(URL, blob); };
  document.getElementById("save").click();
  return true;
})()"""
READ = """new Promise((done) => {
  const reader = new FileReader();
  reader.onload = () => done(reader.result.split(",")[1]);
  reader.readAsDataURL(window.savedFile);
})"""


def saved_by(page: Page) -> bytes:
    """What the button Save gives."""
    page.evaluate(KEEP)
    page.wait_for("window.savedFile?.size > 1000", seconds=4 * PATIENT_S)
    return base64.b64decode(page.evaluate(READ))


@pytest.mark.long
def test_a_character_wears_it_in_its_own_skin(page: Page, body: BodyModel, tmp_path: Path):
    file = tmp_path / "ada.glb"
    file.write_bytes(character(body, scheme="mixamo", scale=100.0, arms_rad=ARMS_DOWN_RAD, yaw_rad=1.0))
    page.choose_file("#character-file", file)
    page.wait_for("document.querySelector('#characters [aria-pressed=true]').dataset.character === 'ada'")
    page.wait_for("!document.getElementById('message').textContent")
    more_frames(page)
    assert page.evaluate("document.getElementById('body-controls').hidden"), "it has its own shape"
    page.evaluate("(() => { document.querySelector('[data-character=\"\"]').click(); return true; })()")
    page.wait_for("!document.getElementById('body-controls').hidden")
    more_frames(page)


@pytest.mark.long
def test_own_clothes_of_a_character_move_and_stay_and_say_why(page: Page, body: BodyModel, tmp_path: Path):
    """A doll in a top that is cloth, with a breastplate that is none: it comes in its own clothes alone."""
    parts = dressed_parts(body, {"top": open_garment(find_garments(["tank"])[0], body)})
    plate = Worn("skirt", parts[-1].vertices * 0.5 + [0.0, 0.6, 0.2], parts[-1].faces, parts[-1].weights)
    file = tmp_path / "doll.glb"
    file.write_bytes(dressed_character(body, [*parts, plate]))
    own = "document.getElementById('own-clothes')"
    assert page.evaluate(f"{own}.hidden"), "our body has none"
    # Browsers keep 250 by themselves, and an upload that is slow is asked for more often.
    page.evaluate("(() => { performance.setResourceTimingBufferSize(100_000); return true; })()")
    page.drop(file)
    page.wait_for(f"!{own}.hidden", seconds=10 * PATIENT_S)
    asked = "performance.getEntriesByType('resource').map(({ name }) => decodeURIComponent(name))"
    page.wait_for(f"{asked}.some((name) => name.includes('/covered?garments=doll~top'))", seconds=4 * PATIENT_S)
    more_frames(page)
    assert page.evaluate(
        "[document.getElementById('alive').checked, document.querySelectorAll('#worn li').length]"
    ) == [True, 0]
    assert page.evaluate("document.getElementById('alive-words').textContent") == "Top of Doll."
    assert "One bone moves all of it, as armour." in page.evaluate("document.getElementById('stiff').textContent")
    page.wait_for_picture(lambda now: share(stage(now), "b") > 0.02, "its own top in its own colour")
    saved = Reader(saved_by(page))
    was = Reader(file.read_bytes()).json
    assert [mesh["name"] for mesh in saved.json["meshes"]][len(was["meshes"]) :][0] == "doll~top"
    assert saved.json["nodes"][: len(was["nodes"])] == was["nodes"] and saved.json["animations"][0]["name"] == "drape"
    assert len(saved.json["materials"]) > len(was["materials"]), "in its own materials"
    click(page, "alive")
    page.wait_for("document.querySelector('#worn li')?.dataset.garment === 'tube'", seconds=4 * PATIENT_S)
    more_frames(page)
    page.evaluate("(() => { document.querySelector('[data-character=\"\"]').click(); return true; })()")
    page.wait_for(f"{own}.hidden")
    more_frames(page)
