"""Garments that are dropped on the page, or chosen: what belongs together is one upload, and it is worn."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest
from PIL import Image

from drape.body.assets import load_body
from drape.body.skeleton import JOINT_NAMES
from drape.garment.cache import Garment
from service.settings import Settings
from tests.clients.browser import PATIENT_S, Page, open_page
from tests.clients.node import page_answer
from tests.drape.cloth.cloth_shapes import tube as tube_shape
from tests.drape.garment.files.test_looks import picture
from tests.drape.garment.garment_files import obj_text
from tests.fixtures.meshes import garment_obj
from tests.fixtures.serving import served

pytestmark = [pytest.mark.browser, pytest.mark.slow]

RED, BLUE = (200, 30, 20), (20, 40, 200)
SAID = "document.getElementById('message').textContent"


@pytest.fixture(scope="module")
def url(make_settings: Callable[..., Settings]) -> Iterator[str]:
    with served(make_settings(intake_queue=6, max_layers=1)) as url:
        yield url


@pytest.fixture(scope="module")
def page(url: str) -> Iterator[Page]:
    with open_page(url + "/?garment=tube&clip=reach", height=800) as page:
        page.wait_for("Number(document.body?.dataset.frames) >= 2")
        page.evaluate(
            "(() => { document.getElementById('play').click(); return true; })()"
        )  # intake steps back for frames
        page.evaluate("(() => { document.getElementById('modelled-on').value = 'standard'; return true; })()")
        yield page


def written(folder: Path, tube: Garment, name: str, colour: tuple[int, int, int]) -> list[Path]:
    """The files of a garment ``name``: its mesh, its materials and, in a folder of its own, its picture."""
    (folder / "textures").mkdir(parents=True, exist_ok=True)
    mesh, materials, image = folder / f"{name}.obj", folder / f"{name}.mtl", folder / f"textures/{name}.png"
    mesh.write_bytes(f"mtllib {name}.mtl\nusemtl cloth\n".encode() + garment_obj(tube))
    materials.write_text(f"newmtl cloth\nmap_Kd textures/{name}.png\n")
    image.write_bytes(picture(colour))
    return [mesh, materials, image]


def ready(page: Page, name: str) -> list[str]:
    """What is worn, once ``name`` is said to be ready."""
    page.wait_for(f"{SAID}.startsWith('{name} is ready')")
    return page.evaluate("Array.from(document.querySelectorAll('#worn li'), (chip) => chip.dataset.garment)")


def colour(url: str, garment: str) -> list[int]:
    """The colour of the first pixel of a garment's picture."""
    told = httpx.get(f"{url}/garments/{garment}/textures/0")
    return np.asarray(Image.open(io.BytesIO(told.content)).convert("RGB"))[0, 0].tolist()


@pytest.mark.long
def test_files_dropped_together_are_one_garment(page: Page, url: str, tube: Garment, tmp_path: Path):
    page.drop(*written(tmp_path, tube, "poppy", RED))
    assert ready(page, "poppy.obj")[-1] == "poppy"
    assert colour(url, "poppy") == list(RED)
    assert page.evaluate("document.getElementById('drop').hidden")


@pytest.mark.long
def test_files_chosen_together_are_one_garment(page: Page, url: str, tube: Garment, tmp_path: Path):
    page.choose_file("#file", *written(tmp_path, tube, "iris", BLUE)[::-1])
    assert ready(page, "iris.obj")[-1] == "iris"
    assert colour(url, "iris") == list(BLUE)


@pytest.mark.long
def test_two_garments_in_a_folder_are_two_uploads_each_with_its_own(
    page: Page, url: str, tube: Garment, tmp_path: Path
):
    folder = tmp_path / "wardrobe"
    written(folder / "one", tube, "rose", RED)
    written(folder / "two", tube, "flax", BLUE)
    (folder / "readme.txt").write_text("words")
    (folder / ".hidden.obj").write_text("no mesh")
    before = {one["id"] for one in httpx.get(url + "/garments").json()}
    page.drop(folder)
    page.wait_for(f"['rose', 'flax'].some((name) => {SAID}.startsWith(`${{name}}.obj is ready`))")
    both = "document.querySelector('.card[data-garment=rose]') && document.querySelector('.card[data-garment=flax]')"
    page.wait_for(both, seconds=2 * PATIENT_S)  # an intake waits for frames of the page
    page.wait_for(f"{SAID}.includes('is ready')")
    assert {one["id"] for one in httpx.get(url + "/garments").json()} - before == {"rose", "flax"}
    assert (colour(url, "rose"), colour(url, "flax")) == (list(RED), list(BLUE))


def test_a_picture_alone_is_told_where_it_belongs(page: Page, tmp_path: Path):
    (tmp_path / "cloth.png").write_bytes(picture(RED))
    page.drop(tmp_path / "cloth.png")
    said = "cloth.png belongs to a garment: drop it together with its mesh."
    page.wait_for(f"{SAID} === {json.dumps(said)}")
    assert page.errors == []


@pytest.mark.long
def test_two_likely_wearers_are_two_pictures_and_a_click_takes_the_other(page: Page, url: str, tmp_path: Path):
    """A tube that is a skirt as well as a strapless top."""
    points, faces = tube_shape(40, 14, radius_m=1.0, height_m=1.0)
    (tmp_path / "wrap.obj").write_bytes(obj_text(100.0 * (points * [0.16, 0.3, 0.12] + [0.3, 0.2, -0.2]), faces))
    page.evaluate("(() => { document.getElementById('modelled-on').value = ''; return true; })()")
    page.drop(tmp_path / "wrap.obj")
    (before,) = ready(page, "wrap.obj")
    assert not page.evaluate("document.getElementById('wearer-card').hidden")
    assert "Which one" in page.evaluate("document.getElementById('wearer-words').textContent")
    sizes = "Array.from(document.querySelectorAll('#wearer-choices img'), (image) => image.naturalWidth).join()"
    page.wait_for(f"{sizes} === '224,224'")
    page.evaluate("(() => { document.querySelector('#wearer-choices [aria-pressed=false]').click(); return true; })()")
    page.wait_for(f"{SAID}.startsWith('wrap.obj is sent') || {SAID}.includes('%')")
    (after,) = ready(page, "wrap.obj")
    assert page.evaluate("document.getElementById('wearer-card').hidden"), "what was chosen is not asked again"
    known = [one["id"] for one in httpx.get(url + "/garments").json()]
    assert after in known and before not in known, "in the place of the first"
    assert page.errors == []


def test_what_a_hand_says_is_an_avatar(tmp_path: Path):
    script = """
    const { avatarOf } = await import(`${WEB}/src/wearer.js`);
    console.log(JSON.stringify(input.asked.map(([said, found]) => avatarOf(said, found))));
    """
    pose = [0.0] * 72
    pose[48:51] = [0.3, 0.2, -0.9]
    told = {"unit": "cm", "up": "z", "facing": "-y", "betas": [1.0], "pose": pose, "trans": [0.0, 0.0, 0.0]}
    found = {"options": {"avatar": json.dumps(told)}}
    asked = [
        [{"unit": "", "up": "", "facing": "", "body": "", "arms": ""}, found],
        [{"unit": "dm", "up": "", "facing": "", "body": "", "arms": ""}, found],
        [{"unit": "", "up": "z", "facing": "", "body": "standard", "arms": ""}, None],
        [{"unit": "", "up": "", "facing": "", "body": '{"gender":1.0}', "arms": "45"}, found],
        [{"unit": "", "up": "", "facing": "", "body": "", "arms": "45"}, found],
    ]
    nothing, unit, standard, phenotype, arms = page_answer(script, {"asked": asked}, tmp_path)
    assert nothing == "" and json.loads(unit) == {"unit": "dm"}
    assert json.loads(standard) == {"betas": [], "up": "z"} and json.loads(phenotype) == {"gender": 1.0}
    arms = json.loads(arms)
    assert {name: arms[name] for name in ("unit", "up", "facing", "betas", "trans")} == {
        name: told[name] for name in ("unit", "up", "facing", "betas", "trans")
    }
    body = load_body()
    for side, elbow in (("left", "left_elbow"), ("right", "right_elbow")):
        joints = body.posed_joints(np.array(arms["pose"]).reshape(1, 24, 3), np.zeros(10))[0]
        rest = body.posed_joints(np.zeros((1, 24, 3)), np.zeros(10))[0]
        ways = [one[JOINT_NAMES.index(elbow)] - one[JOINT_NAMES.index(f"{side}_shoulder")] for one in (rest, joints)]
        drop = [np.degrees(np.arctan2(-way[1], np.hypot(way[0], way[2]))) for way in ways]
        np.testing.assert_allclose(drop[1] - drop[0], 45.0, rtol=0, atol=2.0)
