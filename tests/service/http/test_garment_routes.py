"""Garments in service: caches that are refused or set aside, and pictures of the others."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from PIL import Image

from drape.body.model import BodyModel
from drape.cloth.fabric_table import FABRICS
from drape.errors import ArtifactError, InputError, TooLarge
from drape.garment.bound import BoundMesh
from drape.garment.cache import Garment, save_garment
from drape.wire.folds_message import unpack_folds
from drape.wire.options import FabricNumbers
from service.compute.drape_runtime import DrapeRuntime
from service.compute.garments import check_garment, slug
from service.settings import Settings
from tests.fixtures.garments import tube_garment


def test_a_garment_has_a_picture_that_is_made_once(api: TestClient):
    name = api.get("/garments").json()[0]["id"]
    path = f"/garments/{name}/preview.png"
    answer = api.get(path, params={"size": 96})
    assert answer.status_code == 200 and answer.headers["content-type"] == "image/png"
    image = np.asarray(Image.open(io.BytesIO(answer.content)).convert("L"))
    assert image.shape == (96, 96) and (image < 250).mean() > 0.1 and (image == 255).any()
    again = api.get(path, params={"size": 96})
    assert again.content == answer.content and again.headers["etag"] == answer.headers["etag"]
    for known in (answer.headers["etag"], f'"another", {answer.headers["etag"].removeprefix("W/")}', "*"):
        kept = api.get(path, params={"size": 96}, headers={"If-None-Match": known})
        assert kept.status_code == 304 and not kept.content
    assert api.get(path, params={"size": 96}, headers={"If-None-Match": '"another"'}).content == answer.content
    other = api.get(path, params={"size": 64})
    assert other.headers["etag"] != answer.headers["etag"]
    alone = api.get(path, params={"size": 96, "alone": "true"})
    assert alone.headers["etag"] != answer.headers["etag"]
    undressed = np.asarray(Image.open(io.BytesIO(alone.content)).convert("L"))
    assert 0.1 < (undressed < 250).mean() < (image < 250).mean(), "no less than with the body"


@pytest.mark.parametrize(("name", "size", "status"), [("nobody", 64, 404), (None, 63, 400), (None, 1025, 400)])
def test_what_there_is_no_picture_of_is_refused(api: TestClient, name: str | None, size: int, status: int):
    name = name or api.get("/garments").json()[0]["id"]
    assert api.get(f"/garments/{name}/preview.png", params={"size": size}).status_code == status


def test_what_folds_need_is_a_message_that_comes_once(api: TestClient, body: BodyModel):
    path = "/garments/tube/folds"
    answer = api.get(path, params={"fabric": "denim", "betas": "1,-1"})
    assert answer.status_code == 200 and answer.headers["content-encoding"] == "gzip"
    read = records_of(answer.content)
    garment, sheet = api.get("/garments/tube").json(), read["FoldConstants"]["sheet"]
    assert sheet["place"] == garment["vertices"] and read["BodyFeed"]["rest"] == 72
    coarse = records_of(api.get(path, params={"coarse": True}).content)
    assert coarse["Levels"]["fine"]["sheet"]["place"] == garment["vertices"] and "FoldConstants" not in coarse
    plain = api.get(path, params={"fabric": "denim", "betas": "1,-1"}, headers={"Accept-Encoding": "identity"})
    assert plain.content == answer.content and "content-encoding" not in plain.headers
    kept = api.get(path, params={"fabric": "denim", "betas": "1,-1"}, headers={"If-None-Match": answer.headers["etag"]})
    assert kept.status_code == 304 and not kept.content
    numbers = FABRICS["denim"]
    named = {name: getattr(numbers, name) for name in FabricNumbers.model_fields}
    other = api.get(path, params={"fabric": json.dumps(named), "betas": "1,-1"})
    stiffness = sheet["constants"]
    assert records_of(other.content)["FoldConstants"]["sheet"]["constants"] == pytest.approx(stiffness)
    jersey = api.get(path, params={"fabric": "jersey"}).content
    assert records_of(jersey)["FoldConstants"]["sheet"]["constants"] != stiffness
    joints = body.rest_joints(np.array([1.0, -1.0, *[0.0] * 8])).astype("<f4")
    planes = joints.reshape(-1).view(np.uint8).reshape(-1, 4).T.tobytes()
    assert planes in answer.content and planes not in jersey


def records_of(message: bytes) -> dict[str, Any]:
    return unpack_folds(message)[0]["records"]


@pytest.mark.parametrize(
    ("name", "query", "status"),
    [
        ("nobody", {}, 404), ("tube", {"fabric": "tin"}, 404), ("tube", {"fabric": '{"warp_n_per_m": 1}'}, 400),
        ("tube", {"betas": "a"}, 400), ("tube", {"fabric": "{"}, 400),
    ],
)  # fmt: skip
def test_folds_of_nothing_are_refused(api: TestClient, name: str, query: dict, status: int):
    answer = api.get(f"/garments/{name}/folds", params=query)
    assert answer.status_code == status and "Content-Type" not in answer.json()["cure"]


def spoiled(array: np.ndarray, value: float) -> np.ndarray:
    copy = array.copy()
    copy.flat[0] = value
    return copy


ROWS = np.zeros((4, 3), np.int32)


def hung(garment: Garment, **changed: Any) -> BoundMesh:
    """Four vertices of one triangle that hang on the first vertex of ``garment``."""
    faces, none = np.array([[0, 1, 2]], np.int32), np.zeros((0, 2), np.float32)
    arrays: dict[str, Any] = {"faces": faces, "uv": none, "uv_faces": faces[:0], "face_material": np.zeros(1, np.int32)}
    arrays |= {"corner": ROWS, "weight": np.eye(3)[[0] * 4], "offset": np.zeros((4, 3)), "kind": np.zeros(4, np.uint8)}
    return BoundMesh(garment.name, ("default",), **(arrays | changed))


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        (lambda g: {"body_digest": "0" * 64}, "body_digest"),
        (lambda g: {"chart_patch": spoiled(g.chart_patch, 12)}, r"chart_patch: expected indices in \[0, 12\)"),
        (lambda g: {"chart_patch": spoiled(g.chart_patch, -1)}, "chart_patch: expected indices"),
        (lambda g: {"faces": spoiled(g.faces, 216)}, r"faces: expected indices in \[0, 216\)"),
        (lambda g: {"uv_faces": spoiled(g.uv_faces, 10_000)}, "uv_faces: expected indices"),
        (lambda g: {"chart_weight": g.chart_weight[:, :3]}, "chart_weight: expected shape"),
        (lambda g: {"patch_jet": g.patch_jet[:, :26]}, "patch_jet: expected shape"),
        (lambda g: {"chart_residual": spoiled(g.chart_residual, np.nan)}, "chart_residual: expected finite"),
        (lambda g: {"vertices": spoiled(g.vertices, np.inf)}, "vertices: expected finite"),
        (lambda g: {"vertex_count": 0}, "vertex_count"),
        (lambda g: {"vertex_count": 1000}, "vertex_count"),
        (lambda g: {"drawn": hung(g, corner=spoiled(ROWS, 216))}, r"corner: expected indices in \[0, 216\)"),
        (lambda g: {"drawn": hung(g, kind=np.full(4, 3, np.uint8))}, "kind: expected indices"),
        (lambda g: {"drawn": hung(g, offset=np.full((4, 3), np.nan))}, "drawn offset: expected shape"),
        (lambda g: {"drawn": hung(g, weight=np.ones((3, 3)))}, "drawn weight: expected shape"),
    ],
)
def test_a_cache_that_does_not_fit_together_is_refused_by_name(
    body: BodyModel, tube: Garment, changes: Callable[[Garment], dict], word: str
):
    with pytest.raises(ArtifactError, match=word):
        check_garment(dataclasses.replace(tube, **changes(tube)), body, max_vertices=1000)


def test_too_many_vertices_are_refused(body: BodyModel, tube: Garment):
    check_garment(tube, body, max_vertices=216)
    with pytest.raises(TooLarge, match="at most 215"):
        check_garment(tube, body, max_vertices=215)
    many = {name: np.zeros((217, 3)) for name in ("weight", "offset")}
    drawn = hung(tube, corner=np.zeros((217, 3), np.int32), kind=np.zeros(217, np.uint8), **many)
    with pytest.raises(TooLarge, match="drawn vertices: expected at most 216"):
        check_garment(dataclasses.replace(tube, drawn=drawn), body, max_vertices=216)


def test_a_broken_upload_is_set_aside_and_a_broken_shipped_cache_stops_the_start(
    make_settings: Callable[..., Settings], tmp_path: Path, body: BodyModel, tube: Garment
):
    settings = make_settings(garments_dir=tmp_path)
    (tmp_path / "broken-0.npz").write_bytes(b"PK not an archive")
    save_garment(dataclasses.replace(tube, name="other", body_digest="0" * 64), tmp_path)
    save_garment(dataclasses.replace(tube, name="good"), tmp_path)
    runtime = DrapeRuntime(settings)
    assert [entry.id for entry in runtime.garments.entries()] == ["tube", "good"]
    assert sorted(line.split(":")[0].split("-")[0] for line in runtime.garments.refused) == ["broken", "other"]
    runtime.close()
    with pytest.raises(ArtifactError, match=r"broken-0\.npz"):
        DrapeRuntime(make_settings(shipped_garments_dir=tmp_path))


@pytest.mark.parametrize("name", ["shipped_garments_dir", "motions_dir"])
def test_a_missing_folder_of_shipped_files_stops_the_start(
    make_settings: Callable[..., Settings], tmp_path: Path, name: str
):
    with pytest.raises(InputError, match=rf"^DRAPE_{name.upper()}: expected an existing folder"):
        DrapeRuntime(make_settings(**{name: tmp_path / "none"}))


def test_equal_names_get_different_ids_and_the_same_garment_the_same(
    make_runtime: Callable[..., DrapeRuntime], tmp_path: Path, body: BodyModel, tube: Garment
):
    runtime = make_runtime()
    wide = dataclasses.replace(tube_garment(body, radius_m=0.25), digest="ab" * 32)
    first = runtime.garments.add(runtime.garments.prepare(save_garment(wide, tmp_path)), "user")
    again = runtime.garments.add(runtime.garments.prepare(save_garment(wide, tmp_path)), "user")
    assert first.id == again.id == "tube-abababab"
    assert runtime.garments.get("tube").source == "shipped"
    shipped = runtime.garments.add(runtime.garments.prepare(save_garment(tube, tmp_path)), "user")
    assert (shipped.id, shipped.source) == ("tube", "shipped")
    assert len(runtime.garments.entries()) == 2


@pytest.mark.parametrize(
    ("name", "expected"),
    [("T shirt/../x", "T-shirt-..-x"), ("...", "garment"), ("ärmel", "rmel"), ("a" * 200, "a" * 80)],
)
def test_ids_are_safe_in_paths_and_addresses(name: str, expected: str):
    assert slug(name) == expected
