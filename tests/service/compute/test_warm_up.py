"""The warm-up has every kernel of a service: neither its start nor a request calls one with other types."""

from __future__ import annotations

import gc
import json
import subprocess
import sys
from pathlib import Path

import httpx
import numpy as np
from numba.core.registry import CPUDispatcher

from drape.warm_up import SERVICE
from service.settings import ROOT, Settings
from tests.fixtures.garments import tube
from tests.fixtures.meshes import garment_obj
from tests.fixtures.serving import served
from tests.fixtures.streams import raw_stream
from tests.service.uploads.test_uploads import finished, post

BALL = {"kind": "capsule", "ends": [[0.0, 0.2, 0.2], [0.0, 0.2, 0.2]], "radius_m": 0.05}
ASKED = (
    {},
    {"tier": "fast"},
    {"tier": "accurate", "betas": [1.0]},
    {"coarse": False},
    {"geometry": "jets"},
    {"folds": 0, "coarse": False, "push_out": True},
    {"passes": 0, "motion": 0.5},
    {"colliders": [BALL]},
    {"garments": ["trousers", "tshirt"]},
    {"garments": ["trousers", "tshirt"], "geometry": "jets"},
)


def called() -> dict[str, set[str]]:
    """By kernel the types that it has been called with, from Python or by a kernel that was compiled."""
    kernels = [one for one in gc.get_objects() if type(one) is CPUDispatcher]
    named = [(f"{one.py_func.__module__}.{one.py_func.__name__}", one) for one in kernels]
    return {name: {str(types) for types in one.overloads} for name, one in named if name.startswith("drape.")}


def ask_for_all(folder: Path) -> None:
    """A request of each kind to a service of the shipped garments and model."""
    clip = {"fps": 30.0, "poses": 0.02 * np.arange(3)[:, None, None] * np.ones((3, 24, 3)), "trans": np.zeros((3, 3))}
    clip = {name: np.asarray(value).tolist() for name, value in clip.items()}
    settings = Settings(garments_dir=folder)
    with served(settings) as url, httpx.Client(base_url=url, timeout=300.0) as client:
        job = finished(client, post(client, garment_obj(tube()), name="own.obj", avatar="standard"))
        for options in (*ASKED, {"garment": job["garment"]}):
            asked = ({} if "garments" in options or "garment" in options else {"garment": "tshirt"}) | clip | options
            answer = client.post("/drape", json=asked)
            assert answer.status_code == 200, (options, answer.text)
        answer = client.post("/drape", json={"garment": "tshirt", **clip}, headers={"Accept": "model/gltf-binary"})
        assert answer.status_code == 200, answer.text
        for opening in ({}, {"geometry": "jets"}):
            with raw_stream(url) as stream:
                assert stream.open(garment="tshirt", **opening)["type"] == "opened"
                for sequence in range(1, 4):
                    stream.message(sequence, time_s=0.03 * sequence)


if __name__ == "__main__":
    for part in SERVICE.values():
        part()
    warmed = called()
    ask_for_all(Path(sys.argv[1]))
    print(json.dumps({name: sorted(types - warmed.get(name, set())) for name, types in called().items()}))


def test_a_service_calls_no_kernel_that_the_warm_up_has_not(tmp_path: Path):
    command = [sys.executable, "-m", "tests.service.compute.test_warm_up", str(tmp_path)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout.splitlines()[-1])
    assert len(found) > 100 and not {name: types for name, types in found.items() if types}
