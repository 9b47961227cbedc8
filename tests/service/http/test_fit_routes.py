"""Measures of the body, shapes of measures, and how a garment fits, over HTTP."""

from __future__ import annotations

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.measures import Measures, SectionHeights, landmarks, measures
from drape.body.model import BodyModel
from drape.body.shape_of_measures import measure_ranges, shape_of_measures
from drape.garment.cache import Garment
from drape.garment.ease import Ease
from drape.garment.fit_report import JudgedDrape, Region, fit_report
from service.http.fit_schemas import EaseNumbers, LevelNumbers, MeasureNumbers, RegionNumbers, ShapeRequest

BINARY = {"Accept": "application/octet-stream"}


def test_documents_have_the_fields_of_what_they_tell():
    assert tuple(MeasureNumbers.model_fields) == tuple(ShapeRequest.model_fields) == Measures._fields
    assert tuple(LevelNumbers.model_fields) == SectionHeights._fields
    assert tuple(RegionNumbers.model_fields) == Region._fields
    assert tuple(EaseNumbers.model_fields) == (*Ease._fields, "ease_m")


def test_a_body_tells_its_measures(api: httpx.Client, body: BodyModel):
    shape = np.array([0.5, -1.0, *[0.0] * 8])
    found = api.get(f"/bodies/{body.name}/measures?betas=0.5,-1").json()
    assert found["betas"] == shape.tolist()
    assert found["measures"] == measures(body, shape)._asdict()
    assert found["levels"] == landmarks(body).levels(body.rest_vertices(shape))._asdict()
    assert {name: (one["least"], one["most"]) for name, one in found["ranges"].items()} == measure_ranges(body)
    assert api.get(f"/bodies/{body.name}/measures").json()["measures"] == measures(body)._asdict()


def test_measures_become_a_shape_that_has_them(api: httpx.Client, body: BodyModel):
    asked = {"height_m": 1.7, "chest_m": 0.95}
    found = api.post(f"/bodies/{body.name}/shapes", json=asked).json()
    want = shape_of_measures(body, asked)
    assert_allclose(found["betas"], want.betas, rtol=0.0, atol=1e-9)
    assert found["missed"] == {}
    betas = ",".join(str(number) for number in found["betas"])
    again = api.get(f"/bodies/{body.name}/measures?betas={betas}").json()
    assert again["measures"] == found["measures"]
    assert_allclose([again["measures"][name] for name in asked], list(asked.values()), atol=2e-3)
    missed = api.post(f"/bodies/{body.name}/shapes", json={"height_m": 2.2, "inseam_m": 0.7}).json()["missed"]
    assert missed["height_m"] < 0.0 < missed["inseam_m"]


@pytest.mark.parametrize(
    ("asked", "status", "words"),
    [
        ({"height_m": 170.0}, 422, "height_m: expected 1.259 to 2.408 m, which this body can have, got 170 m"),
        ({"chest_m": None}, 422, "measures: expected some of height_m"),
        ({"height": 1.7}, 400, "height: expected no such field"),
        ({"height_m": -1.7}, 400, "height_m: expected greater than 0"),
    ],
)
def test_measures_that_no_body_has_are_refused(
    api: httpx.Client, body: BodyModel, asked: dict[str, object], status: int, words: str
):
    response = api.post(f"/bodies/{body.name}/shapes", json=asked)
    assert response.status_code == status
    assert words in response.json()["detail"]


def test_unknown_bodies_garments_and_shapes_are_refused(api: httpx.Client, body: BodyModel):
    assert api.get("/bodies/atlas/measures").status_code == 404
    assert api.post("/bodies/atlas/shapes", json={"height_m": 1.7}).status_code == 404
    assert api.post("/garments/cape/fit", json={}).status_code == 404
    assert api.get(f"/bodies/{body.name}/measures?betas=1,x").status_code == 400
    assert api.get(f"/bodies/{body.name}/measures?betas=99").status_code == 422
    assert api.post("/garments/tube/fit", json={"betas": [99.0]}).status_code == 422
    assert api.post("/garments/tube/fit", json={"pose": [[0, 0, 0]] * 23}).status_code == 400
    assert api.post("/garments/tube/fit", json={"pose": [[1e4, 0, 0]] * 24}).status_code == 422
    assert api.post("/garments/tube/fit", json={}, headers={"Accept": "image/png"}).status_code == 406


def test_a_fit_is_that_of_the_smooth_drape(api: httpx.Client, body: BodyModel, tube: Garment):
    betas = [0.3, -0.2]
    drawn = {"garment": "tube", "poses": np.zeros((1, 24, 3)).tolist(), "betas": betas, "push_out": False, "motion": 0}
    draped = np.frombuffer(api.post("/drape", json=drawn, headers=BINARY).content, "<f4").reshape(-1, 3)
    want = fit_report(tube, body, JudgedDrape(body.check_betas(np.array(betas)), draped.astype(np.float64)))
    found = api.post("/garments/tube/fit", json={"betas": betas, "vertices": True}).json()
    assert found["garment"] == "tube"
    assert found["words"] == want.words
    for name, region in found["regions"].items():
        assert_allclose(list(region.values()), want.regions[name], rtol=1e-3, atol=1e-4)
    assert found["regions"].keys() == want.regions.keys()
    for name, girths in found["ease"].items():
        assert_allclose(girths["ease_m"], want.ease[name].ease_m, atol=1e-5)
        assert_allclose(girths["garment_m"] - girths["body_m"], girths["ease_m"], atol=1e-12)
    assert_allclose(found["weft"], want.tension.weft, rtol=0.0, atol=1e-4)
    rows = api.post("/garments/tube/fit", json={"betas": betas}, headers=BINARY)
    assert rows.headers["X-Drape-Vertices"] == "216"
    lists = np.array([found[name] for name in ("warp", "weft", "pressure")], dtype=np.float32).T
    np.testing.assert_array_equal(np.frombuffer(rows.content, "<f4").reshape(-1, 3), lists)
    short = api.post("/garments/tube/fit", json={"betas": betas}).json()
    assert "weft" not in short and short["words"] == found["words"]


def test_ease_stays_that_of_rest_and_strain_is_that_of_the_pose(api: httpx.Client):
    pose = np.zeros((24, 3))
    at_rest = api.post("/garments/tube/fit", json={"vertices": True}).json()
    same = api.post("/garments/tube/fit", json={"vertices": True, "pose": pose.tolist()}).json()
    assert (same["words"], same["ease"]) == (at_rest["words"], at_rest["ease"])
    assert_allclose(same["weft"], at_rest["weft"], rtol=0.0, atol=1e-6)
    pose[3, 0] = 0.8
    bent = api.post("/garments/tube/fit", json={"vertices": True, "pose": pose.tolist()}).json()
    assert bent["ease"] == at_rest["ease"]
    assert np.abs(np.subtract(bent["warp"], at_rest["warp"])).max() > 0.01
