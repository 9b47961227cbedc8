"""The page shows a garment with the pictures of its own materials."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from drape.artifacts import model_folder
from drape.files.looks import Looks, Material
from drape.garment.cache import save_garment
from drape.inference.engine import Engine
from drape.motion.samples import stretch
from service.app import create_app
from service.compute.drape_runtime import DrapeRuntime
from tests.clients.browser import Page, open_page
from tests.clients.test_page import share, stage
from tests.fixtures.garments import shipped
from tests.fixtures.serving import serve
from tests.fixtures.streams import patient_streams

pytestmark = [pytest.mark.browser, pytest.mark.slow]


def checks() -> bytes:
    """A PNG of 8 x 8 squares, red and blue by turns."""
    odd = np.add.outer(np.arange(256) // 32, np.arange(256) // 32) % 2 == 1
    out = io.BytesIO()
    Image.fromarray(np.where(odd[..., None], (190, 30, 30), (30, 60, 190)).astype(np.uint8)).save(out, "PNG")
    return out.getvalue()


@pytest.fixture(scope="module")
def page(make_settings, tmp_path_factory) -> Iterator[Page]:
    folder, motions = tmp_path_factory.mktemp("pictured"), tmp_path_factory.mktemp("motions")
    plain = shipped("tshirt")
    low, extent = plain.uv.min(axis=0), float(np.ptp(plain.uv, axis=0).max())
    scale = (1.0 / extent, 1.0 / extent)  # its coordinates are metres
    look = Material(pictures={"base_colour": 0}, scale=scale, offset=(float(-low[0]) / extent, 0.0))
    save_garment(replace(plain, digest="0" * 64, looks=Looks((look,) * len(plain.material_names), (checks(),))), folder)
    stretch().window(89, 1).save(motions / "still.npz")
    folders = {"shipped_garments_dir": folder, "motions_dir": motions}
    settings = make_settings(model="onefit", **folders)
    runtime = DrapeRuntime(settings, engine=Engine(model_folder("onefit"), compiled=False))
    with (
        patient_streams(),
        serve(create_app(settings, runtime=runtime), settings) as url,
        open_page(url + "/?garment=tshirt&clip=still", height=800) as page,
    ):
        page.wait_for("Number(document.body?.dataset.frames) >= 2")
        yield page


def test_a_garment_has_its_own_colours_in_the_page(page: Page):
    shown = page.wait_for_picture(
        lambda picture: share(stage(picture), "b") > 0.01 and share(stage(picture), "r") > 0.01,
        "no squares in both colours",
    )
    assert shown.size and not page.errors
