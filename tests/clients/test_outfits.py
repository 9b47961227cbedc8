"""Outfits through the Python client, its stream and the command line."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from clients.cli import main
from clients.client import DrapeClient
from clients.stream import DrapeStream
from drape.errors import InputError
from drape.garment.cache import Garment
from drape.motion.clip import MotionClip
from drape.motion.samples import SAMPLES
from tests.fixtures.poses import random_motion


def test_layers_come_apart_and_one_garment_is_itself(outfit_url: str, tube: Garment):
    poses, trans = random_motion(2)
    with DrapeClient(outfit_url) as client:
        inner, outer = client.drape_outfit(["tube", "coat"], poses, trans=trans)
        (alone,) = client.drape_outfit(["tube"], poses, trans=trans)
        assert_array_equal(inner, client.drape("tube", poses, trans=trans))
        assert_array_equal(inner, alone)
        assert outer.shape == inner.shape == (2, tube.vertex_count, 3)
        file = client.drape_glb(["tube", "coat"], MotionClip(poses, trans, 30.0, "random"))
        with pytest.raises(InputError, match="coat twice"):
            client.drape_outfit(["coat", "coat"], poses)
    size = int.from_bytes(file[12:16], "little")
    assert [mesh["name"] for mesh in json.loads(file[20 : 20 + size])["meshes"]] == ["tube", "coat"]


def test_a_stream_parts_the_vertices_of_its_layers(outfit_url: str):
    poses, _ = random_motion(1)
    with DrapeClient(outfit_url) as client:
        expected = client.drape_outfit(["tube", "coat"], poses)

    async def talk() -> tuple[list[np.ndarray], list[np.ndarray]]:
        async with await DrapeStream.open(outfit_url, ["tube", "coat"]) as stream:
            await stream.send(poses[0])
            both = stream.layers((await stream.receive()).frame.vertices())
            await stream.reopen(["tube", "coat"], hidden=["tube"])
            await stream.send(poses[0])
            (seen,) = stream.layers((await stream.receive()).frame.vertices())
            await stream.reopen("coat")
            await stream.send(poses[0])
            return [*both, seen], stream.layers((await stream.receive()).frame.vertices())

    (*both, seen), one = asyncio.run(talk())
    assert len(both) == 2 and len(one) == 1
    assert_allclose(seen, expected[1][0], rtol=0, atol=1e-4)
    for got, wanted in zip(both, expected, strict=True):
        assert_allclose(got, wanted[0], rtol=0, atol=1e-4)


def test_the_command_line_writes_all_layers(outfit_url: str, tmp_path: Path):
    out = tmp_path / "out.npy"
    clip = tmp_path / "clip.npz"
    made = SAMPLES["walk"]()
    np.savez(clip, poses=made.poses[:4].reshape(4, -1), trans=made.trans[:4], mocap_framerate=made.fps)
    base = ["--url", outfit_url, "drape", "--motion", str(clip), "--as-recorded", "--fps", "30"]
    assert main([*base, "--garment", "tube", "coat", "--out", str(out)]) == 0
    both = np.load(out)
    points = tmp_path / "out.pc2"
    assert main([*base, "--garment", "tube", "coat", "--hidden", "tube", "--out", str(points)]) == 0
    seen = np.frombuffer(points.read_bytes()[32:], "<f4").reshape(len(both), -1, 3)
    assert_array_equal(seen, both[:, both.shape[1] // 2 :])
    rows = points.with_suffix(".obj").read_text().splitlines()
    assert sum(row.startswith("v ") for row in rows) == seen.shape[1]
    assert main([*base, "--garment", "tube", "--out", str(out)]) == 0
    assert_array_equal(both[:, : both.shape[1] // 2], np.load(out))
