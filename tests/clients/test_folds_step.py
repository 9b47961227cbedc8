"""The step of folds in WebAssembly is that of the service: on a small sleeve in motion, with every part of the step."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.model import BodyModel
from drape.contact.skin import posed_table
from drape.errors import InputError
from drape.live.clock import Frame
from drape.live.fold_arrays import body_arrays, fold_arrays
from drape.live.fold_step import FoldEffort
from drape.wire.folds import ARRAYS, pack_folds, unpack_folds
from drape.wire.messages import FOLDS
from tests.clients.installed import LIBRARY
from tests.clients.node import answer_of
from tests.drape.live.folds_setup import constants, folded, frame, held_for, sleeve

FRAMES = 24
SCRIPT = """
import { readFileSync } from "node:fs";
import { Folding } from "./folding.js";
const { compiled } = await import(input.step);
const constants = new Uint8Array(readFileSync(input.constants)).buffer;
const folding = await Folding.make({ module: await compiled(), constants });
const { step } = folding;
const view = (place, count) => new Float32Array(step.memory.buffer, place, count);
const frames = input.frames.map(({ vertices, skin, timeS, steps, settle, contact, clearanceM, rest }) => {
  if (rest) folding.rest(rest);
  view(step.skinAt(), skin.length).set(skin);
  const at = view(step.verticesAt(), vertices.length);
  at.set(vertices);
  const happened = step.fold(timeS, steps, settle, contact, clearanceM);
  return { happened, vertices: [...at] };
});
const samples = input.poses.map((pose) => {
  view(step.poseAt(), 72).set(pose);
  step.pose();
  return [...view(step.skinAt(), input.samples)];
});
let refused = "";
try { new Folding(step, new ArrayBuffer(64)); } catch (error) { refused = error.message; }
console.log(JSON.stringify({ frames, samples, refused }));
"""
NO_BODY = {"skin_bones": np.zeros(0), "skin_rows": np.zeros(0), "joints": np.zeros(0), "parents": np.zeros(0)}


def in_client(arrays: dict[str, np.ndarray], frames: list[dict], folder: Path, *, poses=(), samples: int = 0) -> dict:
    """What the client's step makes of ``frames`` with the constants ``arrays``."""
    step = LIBRARY / "dist/folds.js"
    if not step.is_file():
        pytest.skip("@drape/client is not built: `make page`.")
    shutil.copy(step, folder / "step.mjs")
    (folder / "constants.bin").write_bytes(pack_folds(arrays))
    document = {"step": "./step.mjs", "constants": str(folder / "constants.bin"), "frames": frames}
    poses = [np.ravel(pose).tolist() for pose in poses]
    return answer_of(SCRIPT, document | {"poses": poses, "samples": samples}, folder)


def asked(one: Frame, effort: FoldEffort) -> dict:
    return {
        "vertices": one.vertices.astype(np.float32).ravel().tolist(),
        "skin": np.ravel(one.skin).tolist(),
        "timeS": one.time_s,
        "steps": effort.steps,
        "settle": effort.settle,
        "contact": effort.cloth_contact,
        "clearanceM": effort.clearance_m,
    }


@pytest.mark.parametrize(
    ("material", "effort"),
    [
        ("rib", FoldEffort(steps=2, settle=2, cloth_contact=True)),
        ("denim", FoldEffort(steps=1, settle=16, cloth_contact=True, clearance_m=0.0)),
        ("rib", FoldEffort(steps=1, settle=8)),
    ],
)
def test_the_client_is_as_near_to_float64_as_the_service(material: str, effort: FoldEffort, tmp_path: Path):
    rest, _ = sleeve(material)
    frames = [frame(rest, number) for number in range(FRAMES)]
    frames += held_for(frames[-1], 4, start=FRAMES)
    single = np.stack([one for one, *_ in folded(constants(material), frames, effort)])
    double = np.stack([one for one, *_ in folded(constants(material, dtype=np.float64), frames, effort)])
    said = in_client(fold_arrays(constants(material)) | NO_BODY, [asked(one, effort) for one in frames], tmp_path)
    got = np.array([one["vertices"] for one in said["frames"]]).reshape(single.shape)
    assert np.abs(got - double).max() < 10.0 * np.abs(single - double).max()
    assert [one["happened"] for one in said["frames"]] == [1] + [0] * (len(frames) - 1)
    assert "not a FOLDS message" in said["refused"]


def test_a_cut_begins_anew_and_a_rest_does_not(tmp_path: Path):
    rest, _ = sleeve()
    effort = FoldEffort(steps=1, settle=4)
    first, second = frame(rest, 0), frame(rest, 1)
    late = asked(second, effort) | {"timeS": 9.0}
    frames = [asked(first, effort), late, late | {"timeS": 20.0, "rest": 20.0 - 1.0 / 30.0}, late | {"timeS": 19.0}]
    said = in_client(fold_arrays(constants()) | NO_BODY, frames, tmp_path)
    assert [one["happened"] for one in said["frames"]] == [1, 1, 0, 1]
    again = folded(constants(), [second], effort)[0][0]
    assert_allclose(np.reshape(said["frames"][1]["vertices"], (-1, 3)), again, rtol=0, atol=1e-6)


def test_no_folds_are_better_than_those_that_are_none(tmp_path: Path):
    rest, _ = sleeve()
    effort = FoldEffort(steps=1, settle=2)
    torn = asked(frame(rest, 0), effort)
    torn["vertices"][0] = 1e30  # a vertex far away: its neighbours follow
    said = in_client(fold_arrays(constants()) | NO_BODY, [torn, asked(frame(rest, 1), effort)], tmp_path)
    assert said["frames"][0]["happened"] == 7  # settled, begun anew, lost
    assert_allclose(said["frames"][0]["vertices"], torn["vertices"], rtol=1e-6)
    assert said["frames"][1]["happened"] == 1


def test_the_client_poses_the_skin_as_the_service_does(body: BodyModel, rng, tmp_path: Path):
    poses, betas = rng.uniform(-0.8, 0.8, (3, 24, 3)), rng.normal(size=body.shape_count)
    poses[0] = 0.0
    expected = posed_table(body, poses.astype(np.float32), betas).reshape(3, -1, 8)
    arrays = fold_arrays(constants())
    arrays["reach_m2"] = np.zeros(len(expected[0]))  # as many samples as the body has
    said = in_client(arrays | body_arrays(body, betas), [], tmp_path, poses=poses, samples=expected[0].size)
    got = np.reshape(said["samples"], expected.shape)
    assert_allclose(got, expected, rtol=0, atol=2e-5)


def test_the_message_holds_what_was_packed_and_nothing_else_is_read():
    arrays = fold_arrays(constants()) | NO_BODY
    message = pack_folds(arrays)
    read = unpack_folds(message)
    assert list(read) == list(ARRAYS)
    for name, array in read.items():
        assert_allclose(array, np.ravel(arrays[name]), rtol=1e-7, err_msg=name)
    for wrong, expected in (
        (message[:20], "folds message"),
        (message[:-4], "folds message"),
        (message[:5] + b"\x05" + message[6:], f"kind {FOLDS}"),
        (message[:12] + b"\x01" + message[13:], "45 arrays"),
    ):
        with pytest.raises(InputError, match=expected):
            unpack_folds(wrong)
