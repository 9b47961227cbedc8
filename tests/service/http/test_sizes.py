"""Sizes over HTTP: told, worn by a drape and an outfit, fitted, advised, and refused in words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest

from drape.body.measures import measures
from drape.body.model import BodyModel
from drape.errors import ArtifactError, InputError, NotFound
from drape.garment.cache import Garment
from drape.garment.size_chart import SIZES
from drape.garment.sizes import save_table, table_path
from drape.stages.scene import Entry, Outfit
from drape.stages.sizes import Sizes
from drape.wire.layout import unpack_layout
from tests.fixtures.garments import tube_sizes

BINARY = {"Accept": "application/octet-stream"}
STILL = np.zeros((1, 24, 3)).tolist()


def draped(api: httpx.Client, **asked: object) -> np.ndarray:
    answer = api.post("/drape", json={"poses": STILL, "push_out": False, **asked}, headers=BINARY)
    assert answer.status_code == 200, answer.text
    return np.frombuffer(answer.content, "<f4").reshape(-1, 3)


def width(vertices: np.ndarray) -> float:
    return float(np.ptp(vertices[:, 0]))


def test_a_garment_tells_its_sizes_and_whom_they_are_cut_for(api: httpx.Client, body: BodyModel):
    sizes = api.get("/garments/tube").json()["sizes"]
    assert tuple(one["size"] for one in sizes) == SIZES
    assert sizes[0]["chest_m"] < sizes[3]["chest_m"] and sizes[0]["waist_m"] is None
    least, most = sizes[1]["cut_for"]["chest_m"]
    assert least < measures(body).chest_m < most == sizes[2]["cut_for"]["chest_m"][0]


def test_a_larger_size_is_draped_wider_than_a_smaller_one(api: httpx.Client):
    widths = [width(draped(api, garment="tube", size=size)) for size in SIZES]
    assert (np.diff(widths) > 0.005).all()
    assert (draped(api, garment="tube") == draped(api, garment="tube", size="M")).all()


def test_mesh_and_jets_are_those_of_the_size(api: httpx.Client, tube: Garment):
    mesh = api.get("/garments/tube/mesh", params={"size": "XL"}).json()
    assert width(np.array(mesh["vertices"])) > width(tube.vertices) + 0.03
    assert np.max(mesh["uv"]) > 1.1  # panels grow too, so that prints and weaves keep their scale
    rest = [
        unpack_layout(api.get("/garments/tube/jets", params=asked, headers=BINARY).content).rest
        for asked in ({}, {"size": "XL"})
    ]
    assert width(rest[1]) > width(rest[0]) + 0.03


def test_ease_grows_with_the_size(api: httpx.Client):
    found = [api.post("/garments/tube/fit", json={"size": size}).json()["ease"] for size in ("S", "M", "XL")]
    levels = set.intersection(*(set(one) for one in found))
    assert levels
    for level in levels:
        assert (np.diff([one[level]["ease_m"] for one in found]) > 0.0).all()


def test_a_body_is_told_what_it_takes(api: httpx.Client, body: BodyModel):
    usual = api.get("/garments/tube/size").json()
    assert usual["size"] == "M" and usual["words"].startswith("chest ")
    shape = api.post(f"/bodies/{body.name}/shapes", json={"chest_m": measures(body).chest_m + 0.1}).json()["betas"]
    betas = ",".join(str(number) for number in shape)
    assert api.get(f"/garments/tube/size?betas={betas}").json()["size"] == "L"
    assert api.get("/garments/cape/size").status_code == 404


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"garment": "tube", "size": "XXL"}, "size: expected one of S, M, L, XL of tube, got XXL. The nearest is XL."),
        ({"garment": "tube", "size": "xs"}, "got xs. The nearest is S."),
        ({"garment": "tube", "size": ["M", "L"]}, "size: expected one for all, or 1: one for each garment, got 2"),
    ],
)
def test_a_size_that_there_is_not_is_refused_in_words(api: httpx.Client, asked: dict[str, object], words: str):
    answer = api.post("/drape", json={"poses": STILL, **asked})
    assert answer.status_code in (400, 404) and words in answer.json()["detail"]


def test_a_garment_of_one_size_is_said_to_be_one(body: BodyModel, tube: Garment, tmp_path: Path):
    sizes, entry = Sizes(body, tmp_path, []), Entry("tube", tube, "shipped")
    assert sizes.measures(entry) == {} and sizes.wear(entry, None) is entry
    for ask in (lambda: sizes.wear(entry, "L"), lambda: sizes.advice(entry, np.zeros(body.shape_count))):
        with pytest.raises(NotFound, match="size: expected none: tube comes in one"):
            ask()


def test_a_table_that_is_spoilt_stops_the_start(body: BodyModel, tube: Garment, tmp_path: Path):
    path = table_path(tmp_path, tube)
    path.parent.mkdir()
    path.write_bytes(b"no table")
    with pytest.raises(ArtifactError, match="expected a table of sizes"):
        Sizes(body, tmp_path, [Entry("tube", tube, "shipped")])


def test_each_layer_of_an_outfit_has_its_size(body: BodyModel, tube: Garment, tmp_path: Path):
    save_table(tube_sizes(tube), table_path(tmp_path, tube))
    entry = Entry("tube", tube, "shipped")
    sizes = Sizes(body, tmp_path, [entry])
    outfit = Outfit((entry, replace(entry, id="other")))
    inner, outer = sizes.wear(outfit, [None, "XL"]).layers
    assert inner is entry and outer.id == "other" and width(outer.garment.vertices) > width(tube.vertices)
    assert sizes.wear(outfit, "XL").layers[1].garment is outer.garment, "made once"
    with pytest.raises(InputError, match="size: expected one for all, or 2: one for each garment, got 1"):
        sizes.wear(outfit, ["L"])
