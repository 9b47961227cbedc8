"""Jets through the Python clients, and the page's decoder beside them."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from numpy.testing import assert_allclose

from clients.client import DrapeClient
from clients.stream import DrapeStream, ReceivedJets
from drape.errors import InputError
from drape.wire import messages as wire
from drape.wire.jets import pack_jets, unpack_jets
from drape.wire.layout import pack_layout
from tests.clients.node import answer_of
from tests.fixtures.patience import PATIENT_S
from tests.fixtures.poses import random_motion

QUANTISED_M = 1e-4
POSES, TRANS = random_motion(2)
SCRIPT = """
import { JetSurface } from "./jets.js";
import { kindOf, KIND, unpackJets, unpackLayout } from "./wire.js";
const bytes = (hex) => Uint8Array.from(Buffer.from(hex, "hex")).buffer;
const frame = unpackJets(bytes(input.frame));
const surface = new JetSurface(unpackLayout(bytes(input.layout)));
const positions = new Float32Array(3 * surface.vertexCount);
surface.evaluate(frame, positions, input.first);
const said = (task) => { try { task(); return ""; } catch (error) { return error.message; } };
console.log(JSON.stringify({
  header: frame.header, positions: [...positions], jet: [...frame.jet], rotation: [...frame.rotation],
  jets: kindOf(bytes(input.frame)) === KIND.JETS, patches: surface.patchCount,
  short: said(() => unpackJets(new ArrayBuffer(20))),
  cut: said(() => unpackJets(bytes(input.frame).slice(0, -4))),
  other: said(() => unpackLayout(bytes(input.frame))),
  part: said(() => unpackLayout(bytes(input.layout).slice(0, -4))),
}));
"""


def test_clips_of_jets_become_vertices(outfit_url: str):
    with DrapeClient(outfit_url) as client:
        layout = client.jet_layout("tube")
        frames = client.drape_jets("tube", POSES, trans=TRANS, push_out=False)
        expected = client.drape("tube", POSES, trans=TRANS, push_out=False)
        both = client.drape_jets(["tube", "coat"], POSES, trans=TRANS)
        faces = np.array(client.mesh("tube")["faces"])
    got = np.stack([layout.vertices(frame) for frame in frames])
    assert np.abs(got - expected).max() < QUANTISED_M
    assert [len(part.jet) for part in both[0].layers([12, 12])] == [12, 12]
    finer, _ = layout.subdivided(faces)
    assert_allclose(finer.vertices(frames[0])[: len(layout.rest)], got[0], rtol=0, atol=2e-6)
    with pytest.raises(InputError, match="part an outfit's frame into layers first"):
        layout.vertices(both[0])


def test_a_stream_of_jets(outfit_url: str):
    with DrapeClient(outfit_url) as client:
        layout, expected = client.jet_layout("tube"), client.drape("tube", POSES, trans=TRANS)
        clip = client.drape_jets("tube", POSES, trans=TRANS)

    async def talk() -> tuple[ReceivedJets, wire.Frame]:
        async with await DrapeStream.open(outfit_url, "tube", geometry="jets") as stream:
            assert stream.about["patches"] == 12
            await stream.send(POSES[0], TRANS[0])
            received = await stream.receive_jets()
            await stream.reopen("tube")
            await stream.send(POSES[0], TRANS[0])
            frame = (await stream.receive()).frame
            await stream.reopen("tube", geometry="jets")
            await stream.send(POSES[0], TRANS[0])
            with pytest.raises(InputError, match="expected kind 3, got kind 4"):
                await stream.receive()
            return received, frame

    received, frame = asyncio.run(talk())
    assert 0.0 < received.age_s < PATIENT_S
    assert np.abs(layout.vertices(received.frame) - layout.vertices(clip[0])).max() < QUANTISED_M
    assert received.frame.pushed and received.frame.left_m == pytest.approx(clip[0].left_m, abs=1e-5)
    assert np.abs(frame.vertices() - expected[0]).max() < 1e-4


def test_the_page_makes_the_same_vertices(outfit_url: str, tmp_path):
    with DrapeClient(outfit_url) as client:
        layout, frame = client.jet_layout("coat"), client.drape_jets(["tube", "coat"], POSES, trans=TRANS)[1]
    message = pack_jets(frame)
    read = unpack_jets(message)
    document = {"frame": message.hex(), "layout": pack_layout(layout).hex(), "first": 12}
    got = answer_of(SCRIPT, document, tmp_path)
    assert got["jets"] and got["patches"] == 12
    assert got["header"]["sequence"] == frame.sequence and got["header"]["flags"] == wire.FLAG_PUSHED
    assert got["header"]["left_m"] == pytest.approx(frame.left_m)
    assert_allclose(np.reshape(got["jet"], (24, 45)), read.jet, rtol=0, atol=1e-6)
    assert_allclose(np.reshape(got["rotation"], (24, 3, 3)), read.rotation, rtol=0, atol=1e-6)
    expected = layout.positions(read.layers([12, 12])[1])
    assert_allclose(np.reshape(got["positions"], (-1, 3)), expected, rtol=0, atol=2e-6)
    assert "too short" in got["short"] and "wrong size" in got["cut"] and "wrong size" in got["part"]
    assert "not a LAYOUT message" in got["other"]
