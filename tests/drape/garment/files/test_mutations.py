"""Files with a few wrong bits, and files that claim much: each is answered in words, in bounded time and memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from tests.architecture.repository import ROOT
from tests.drape.files.test_gltf_compressed import draco_gltf, meshopt_gltf
from tests.drape.garment.files.test_fbx_mesh import POLYGONS, SQUARE, UV
from tests.drape.garment.files.test_looks import OBJ, ZIP, glb_of, picture, told_size, whole, zipped
from tests.drape.garment.files.test_usd_looks import PICTURES, usda
from tests.fixtures.fbx_writer import fbx_of

MESHOPT = find_spec("meshoptimizer") is not None  # it has no wheel
EACH = 28  # with the next more than 200 in all
NEW = 32  # of the files whose readers are others' and the newest
MANY = 260  # of each format in the long form, more than 2,000 in all
SECONDS, BYTES = 60, 3 * 2**29  # of one file; of the process that reads them all

# Reads files one after the other; the last line names the one that it was at.
READ = f"""
import resource, signal, sys
from pathlib import Path
from drape.errors import DrapeError
from drape.garment.files.mesh import read_mesh
resource.setrlimit(resource.RLIMIT_AS, ({BYTES}, {BYTES}))
for path in sorted(Path(sys.argv[1]).iterdir()):
    print(path.name, end=" ", flush=True)
    signal.alarm({SECONDS})
    try:
        read_mesh(path)
        print("read", flush=True)
    except DrapeError as error:
        assert error.expected and error.got and error.cure
        print("refused", flush=True)
"""


def good_files() -> dict[str, bytes]:
    return {
        "zip": zipped(ZIP),
        "stored.zip": zipped(ZIP, 0),
        "glb": glb_of(whole()),
        "draco.gltf": json.dumps(draco_gltf()).encode(),
        **({"meshopt.gltf": json.dumps(meshopt_gltf()).encode()} if MESHOPT else {}),
        "fbx": fbx_of(SQUARE, POLYGONS, UV, material=(1, 0), pictures=(("red.png", picture()),)),
        "looks.usda": usda(rough="</Looks/Cloth/R.outputs:r>").encode(),
        "looks.usdz": zipped({"shirt.usda": usda(rough="</Looks/Cloth/R.outputs:r>")} | PICTURES, 0),
    }


def claiming_files() -> dict[str, bytes]:
    """Small files that ask for much."""
    many, deep, wide = draco_gltf(), draco_gltf(), meshopt_gltf() if MESHOPT else {"bufferViews": []}
    many["accessors"][1]["count"] = 30_000_000
    deep["nodes"] = [{"children": [i + 1]} for i in range(4000)] + [{"mesh": 0}]
    deep["scenes"] = [{"nodes": [0]}]
    for view in wide["bufferViews"]:
        view["extensions"]["EXT_meshopt_compression"]["count"] = 10_000_000
    bomb = told_size(12_000, 12_000)
    return {
        "many.gltf": json.dumps(many).encode(),
        "deep.gltf": json.dumps(deep).encode(),
        "wide.gltf": json.dumps(wide).encode(),
        "picture.zip": zipped(ZIP | {"coat/tex/cloth red.png": bomb}),
        "nan.zip": zipped(ZIP | {"coat/coat.obj": OBJ.replace("v ", "v nan ", 1)}),
        "colour.zip": zipped(ZIP | {"coat/cloth.mtl": "newmtl front\nKd nan inf 1e999\nd -3\nmap_Kd -s\n"}),
        "zeros.zip": zipped({"a.obj": b"\0" * 2**27}),
        "within.zip": zipped({"a.zip": zipped({"b.zip": zipped(ZIP)})}),
    }


@pytest.mark.parametrize("each", [None, pytest.param(MANY, marks=pytest.mark.long)])
def test_each_of_many_broken_files_is_answered_in_words(each: int | None, tmp_path: Path):
    rng, folder = np.random.default_rng(11), tmp_path / "files"
    folder.mkdir()
    files = claiming_files()
    for kind, content in good_files().items():
        for number in range(each or (NEW if kind in ("fbx", "looks.usda", "looks.usdz") else EACH)):
            changed = np.frombuffer(content, np.uint8).copy()
            if number % 3 == 0:
                changed = changed[: rng.integers(len(changed))]
            else:
                places = rng.integers(0, len(changed), 1 + number // 3 % EACH)
                changed[places] ^= (1 << rng.integers(0, 8, len(places))).astype(np.uint8)
            files[f"{number}.{kind}"] = changed.tobytes()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    several = {"OPENBLAS_NUM_THREADS": "1"}  # whose stacks would count
    command = [sys.executable, "-c", READ, str(folder)]
    done = subprocess.run(command, cwd=ROOT, env=os.environ | several, capture_output=True, text=True)
    answers = dict(line.split(" ", 1) for line in done.stdout.splitlines() if " " in line)
    assert done.returncode == 0, (done.stdout[-200:], done.stderr[-2000:])
    assert set(answers) == set(files) and set(answers.values()) == {"read", "refused"}
