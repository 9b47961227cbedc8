"""A garment's picture: what is in it, its size, and that a client that has it is told so."""

from __future__ import annotations

import io

import numpy as np
import pytest
from fastapi.testclient import TestClient
from PIL import Image

from service.http.pictures import CLOTH, KEPT, Previews, picture
from tests.drape.cloth.cloth_shapes import grid


def test_a_picture_shows_the_cloth_in_the_middle_and_what_stands_behind_it():
    square, faces = grid(40, 40, cell_m=0.05)
    square = square - square.mean(axis=0) + np.array([0.0, 0.0, 0.1])
    behind = (square - np.array([0.0, 0.0, 0.2])) * np.array([1.0, 0.2, 1.0])
    for size in (64, 600):
        image = Image.open(io.BytesIO(picture((0.5 * square, faces), (behind, faces), size)))
        assert image.format == "PNG" and image.size == (size, size)
        pixels = np.asarray(image.convert("RGB"), dtype=float) / 255.0
        middle, corner, beside = pixels[size // 2, size // 2], pixels[1, 1], pixels[size // 2, 1]
        assert (corner == 1.0).all(), "nothing is there"
        np.testing.assert_allclose(middle / middle.max(), np.array(CLOTH) / max(CLOTH), atol=0.03)
        assert beside[0] > 1.15 * beside[2], "skin is redder than cloth"


def test_a_garment_has_a_picture_that_is_made_once(api: TestClient):
    name = api.get("/garments").json()[0]["id"]
    path = f"/garments/{name}/preview.png"
    answer = api.get(path, params={"size": 96})
    assert answer.status_code == 200 and answer.headers["content-type"] == "image/png"
    image = np.asarray(Image.open(io.BytesIO(answer.content)).convert("L"))
    assert image.shape == (96, 96) and (image < 250).mean() > 0.1 and (image == 255).any()
    again = api.get(path, params={"size": 96})
    assert again.content == answer.content and again.headers["etag"] == answer.headers["etag"]
    for known in (answer.headers["etag"], f'"another", W/{answer.headers["etag"]}', "*"):
        kept = api.get(path, params={"size": 96}, headers={"If-None-Match": known})
        assert kept.status_code == 304 and not kept.content
    assert api.get(path, params={"size": 96}, headers={"If-None-Match": '"another"'}).content == answer.content
    other = api.get(path, params={"size": 64})
    assert other.headers["etag"] != answer.headers["etag"]


@pytest.mark.parametrize(("name", "size", "status"), [("nobody", 64, 404), (None, 63, 400), (None, 1025, 400)])
def test_what_there_is_no_picture_of_is_refused(api: TestClient, name: str | None, size: int, status: int):
    name = name or api.get("/garments").json()[0]["id"]
    assert api.get(f"/garments/{name}/preview.png", params={"size": size}).status_code == status


def test_so_many_pictures_are_kept_and_the_ones_asked_for_last():
    kept = Previews()
    for size in range(KEPT):
        kept.keep("a", size, b"%d" % size)
    assert kept.get("a", 0) == b"0"
    kept.keep("b", 0, b"new")
    assert kept.get("a", 1) is None and kept.get("a", 0) == b"0" and kept.get("b", 0) == b"new"
