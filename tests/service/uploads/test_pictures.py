"""A garment that is uploaded with its pictures has them in the service."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator

import httpx
import numpy as np
import pytest
from PIL import Image

from drape.garment.cache import Garment
from drape.garment.files.mesh import read_mesh
from service.settings import Settings
from tests.drape.garment.files.test_looks import picture, zipped
from tests.fixtures.meshes import garment_obj
from tests.fixtures.patience import ended_job
from tests.fixtures.serving import served
from tests.service.uploads.test_uploads import post

RED = (200, 30, 20)
MTL = b"newmtl cloth\nmap_Kd cloth.png\n"


@pytest.fixture(scope="module")
def uploads(make_settings: Callable[..., Settings]) -> Iterator[httpx.Client]:
    with served(make_settings(intake_queue=6)) as url, httpx.Client(base_url=url, timeout=60.0) as client:
        yield client


@pytest.fixture
def files(tube: Garment) -> dict[str, bytes]:
    obj = b"mtllib tube.mtl\nusemtl cloth\n" + garment_obj(tube)
    return {"tube.obj": obj, "tube.mtl": MTL, "cloth.png": picture(RED)}


def test_a_zip_brings_pictures_that_come_back(uploads: httpx.Client, files: dict[str, bytes]):
    job = ended_job(uploads, post(uploads, zipped(files), name="Red Tube.zip", avatar="standard"))
    assert (job["state"], job["notes"]) == ("done", []), job
    looks = uploads.get(f"/garments/{job['garment']}/looks").json()
    (material,) = looks["materials"]
    assert material["pictures"] == {"base_colour": 0}
    (run,) = looks["runs"]
    assert run[0] == run[2] == 0 and run[1] == uploads.get(f"/garments/{job['garment']}").json()["faces"]
    told = uploads.get(f"/garments/{job['garment']}/textures/0")
    assert told.headers["Content-Type"] == "image/png" and told.headers["X-Content-Type-Options"] == "nosniff"
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(told.content)))[0, 0], RED)
    assert uploads.get(f"/garments/{job['garment']}/textures/1").status_code == 404
    glb = uploads.get(f"/garments/{job['garment']}/mesh", headers={"Accept": "model/gltf-binary"}).content
    assert read_mesh(glb).looks.pictures == (told.content,)
    finer = uploads.get(f"/garments/{job['garment']}/looks", params={"resolution": "fine"}).json()
    assert finer["materials"] == looks["materials"]


def test_a_form_brings_pictures_too(uploads: httpx.Client, files: dict[str, bytes]):
    parts = [("file", (name, content)) for name, content in files.items()]
    job = ended_job(uploads, uploads.post("/garments", params={"name": "formed", "avatar": "standard"}, files=parts))
    assert (job["state"], job["notes"]) == ("done", []), job
    assert uploads.get(f"/garments/{job['garment']}/textures/0").status_code == 200


def test_a_picture_that_is_not_there_is_told(uploads: httpx.Client, files: dict[str, bytes]):
    del files["cloth.png"]
    job = ended_job(uploads, post(uploads, zipped(files), name="bare.zip", avatar="standard"))
    assert job["notes"] == ["'cloth.png' is not beside the mesh: send it in the same zip"]
