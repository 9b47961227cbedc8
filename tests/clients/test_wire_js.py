"""The browser's copy of the wire is the one definition, and computes the same."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.model import BodyModel
from drape.export.glb_body import heaviest_bones
from drape.geometry.rotations import rotvec_to_matrix
from drape.wire import messages as wire
from drape.wire.mesh_messages import STEP_M, pack_body_mesh
from drape.wire.options import Advanced, DrapeOptions, wire_names
from drape.wire.rig_pose_message import RigPose, pack_rig_pose
from tests.architecture.repository import ROOT
from tests.clients.node import answer_of

SCRIPT = """
import { packPose, packRigPose, packAck, unpackFrame, dequantise, SUBPROTOCOL } from "./wire.js";
const hex = (buffer) => Buffer.from(buffer).toString("hex");
const bytes = Uint8Array.from(Buffer.from(input.frame, "hex"));
const frame = unpackFrame(bytes.buffer);
const positions = new Float32Array(frame.steps.length);
dequantise(frame, positions);
let short = "";
try { unpackFrame(new ArrayBuffer(8)); } catch (error) { short = error.message; }
bytes[4] ^= 1;
let stale = "";
try { unpackFrame(bytes.buffer); } catch (error) { stale = error.message; }
console.log(JSON.stringify({
  pose: hex(packPose(input.pose)), ack: hex(packAck(input.ack)), header: frame.header, positions: [...positions],
  rig: [{ ...input.rig, place: null }, input.rig].map((pose) => hex(packRigPose(pose))),
  protocol: SUBPROTOCOL, short, stale,
}));
"""


def test_generated_copy_is_current():
    run = subprocess.run([sys.executable, "scripts/sync_wire.py", "--check"], cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize("bits", [8, 16])
def test_javascript_reads_and_writes_what_python_does(tmp_path, bits: int):
    generator = np.random.default_rng(3)
    pose, trans = generator.normal(size=(24, 3)).astype(np.float32), generator.normal(size=3)
    vertices = generator.normal(size=(7, 3)).astype(np.float32)
    root = np.array([1.0, 2.0, 3.0])
    message = wire.pack_frame(wire.Frame(9, 2.5, 3.5, root, vertices, 4, 55, True, 0.5, 0.25, bits=bits))
    document = {
        "frame": message.hex(),
        "ack": 4_000_000_000,
        "pose": {"sequence": 8, "clientTimeS": 1.25, "trans": trans.tolist(), "pose": pose.ravel().tolist()},
    }
    turns = generator.normal(size=(5, 4)).astype(np.float32)
    document["rig"] = {
        "sequence": 8,
        "clientTimeS": 1.25,
        "place": trans.tolist(),
        "quaternions": turns.ravel().tolist(),
    }
    got = answer_of(SCRIPT, document, tmp_path)
    assert got["rig"] == [pack_rig_pose(RigPose(8, 1.25, place, turns)).hex() for place in (None, trans)]
    assert got["pose"] == wire.pack_pose(wire.Pose(8, 1.25, trans, pose)).hex()
    assert got["ack"] == wire.pack_ack(4_000_000_000).hex()
    assert got["protocol"] == wire.SUBPROTOCOL
    read = wire.unpack_frame(message)
    header = got["header"]
    assert (header["sequence"], header["count"], header["dropped"], header["residence_us"]) == (9, 7, 4, 55)
    assert header["root"] == [1.0, 2.0, 3.0]
    assert_allclose(np.reshape(got["positions"], (-1, 3)), read.positions, rtol=0, atol=1e-6)
    assert "too short" in got["short"] and "reload" in got["stale"]


RIG = """
import { Drape } from "./core.js";
import { Wearing } from "./wearing.js";
const wearing = new Wearing(new Drape("http://localhost"), ["tube"], {});
const { stream } = wearing;
const sent = [], refused = [];
Object.assign(stream, { ready: true, socket: { send: (bytes) => sent.push(Buffer.from(bytes).toString("hex")) } });
const tried = (...pose) => {
  try { return wearing.rigPose(...pose); } catch (error) { refused.push(error.expected); return error.kind; }
};
const told = [tried(input.turns)];
stream.opened = { nodes: 5 };
told.push(tried(input.turns, input.place), tried(input.turns.flat()), tried(input.turns.slice(1)));
console.log(JSON.stringify({ sent, refused, told }));
"""


def test_the_library_sends_poses_of_a_rig_where_the_service_takes_them(tmp_path):
    turns = np.random.default_rng(4).normal(size=(5, 4)).astype(np.float32)
    place = [0.5, 1.0, -2.0]
    got = answer_of(RIG, {"turns": turns.tolist(), "place": place}, tmp_path)
    assert got["told"] == ["MotionError", True, True, "MotionError"]
    assert got["refused"] == ["a garment that is worn by an avatar", "5 quaternions, one a node of the avatar"]
    for number, (message, there) in enumerate(zip(got["sent"], (np.array(place), None), strict=True), 1):
        wanted = pack_rig_pose(RigPose(number, 0.0, there, turns))
        sent = bytes.fromhex(message)
        assert sent[:16] + sent[24:] == wanted[:16] + wanted[24:]  # all but the time


def test_controls_of_the_page_name_options_of_the_wire():
    page = (ROOT / "clients/web/src/index.html").read_text()
    for place, model, one in (("option", DrapeOptions, "resolution"), ("advanced", Advanced, "push_out")):
        named = set(re.findall(rf'data-{place}="(\w+)"', page))
        assert one in named
        assert named <= set(wire_names(model).values())


def test_ids_of_the_page_name_one_element_each():
    ids = re.findall(r'\sid="([^"]+)"', (ROOT / "clients/web/src/index.html").read_text())
    assert "view" in ids
    assert len(ids) == len(set(ids))


BODY = """
import { unpackBody } from "./meshes.js";
const body = unpackBody(Uint8Array.from(Buffer.from(input.message, "hex")).buffer);
console.log(JSON.stringify(Object.fromEntries(Object.entries(body).map(([name, numbers]) => [name, [...numbers]]))));
"""


def test_a_posed_body_is_where_it_was_before_it_was_packed(body: BodyModel, rng, tmp_path):
    rest, joints = (part(np.zeros(body.shape_count)) for part in (body.rest_vertices, body.rest_joints))
    bones, weights = heaviest_bones(body)
    turns = rotvec_to_matrix(rng.normal(size=(24, 3)))

    def posed(places: np.ndarray, bones: np.ndarray, weights: np.ndarray) -> np.ndarray:
        turned = np.einsum("vkij,vkj->vki", turns[bones], places[:, None] - joints[bones]) + joints[bones]
        return (weights[..., None] * turned).sum(axis=1)

    read = answer_of(BODY, {"message": pack_body_mesh(rest, body.faces, joints, bones, weights).hex()}, tmp_path)
    assert read["index"] == body.faces.ravel().tolist()
    assert_allclose(np.reshape(read["joints"], (24, 3)), joints, rtol=0, atol=1e-6)
    others = np.reshape(read["bones"], (-1, 4)), np.reshape(read["weights"], (-1, 4))
    off_m = posed(np.reshape(read["positions"], (-1, 3)), *others) - posed(rest, bones, weights)
    assert np.linalg.norm(off_m, axis=1).max() < STEP_M  # each coordinate was rounded to half of a step
