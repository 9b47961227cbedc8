"""Key points to poses in the web library: the numbers of ``drape.motion.landmarks``, which it is written after."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.model import BodyModel
from drape.body.skeleton import PARENTS
from drape.catalog import find_motions
from drape.geometry.rigid import bone_transforms
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.landmarks import LandmarkPoses
from drape.motion.one_euro import OneEuro
from drape.motion.readers import read_motion
from tests.clients.node import answer_of
from tests.drape.motion.people import person

DT_S = 1.0 / 30.0
STREAM = """
import { landmarkSource } from "./landmarks.js";
const source = landmarkSource({ layout: input.layout, smoothing: input.smoothing });
source.put(input.points[0]);
const early = source.sample();
await source.begin({ body: async () => ({ joints: input.joints, floor_m: input.floor_m }) });
const found = input.points.map((points, frame) => {
  source.put(points, input.visibility?.[frame], frame / 30);
  return source.sample();
});
console.log(JSON.stringify({ early, poses: found.map(({ poses }) => poses), trans: found.map(({ trans }) => trans) }));
"""
REFUSALS = """
import { landmarkSource } from "./landmarks.js";
const told = [];
const tell = (task) => { try { task(); told.push(""); } catch (error) { told.push(error.message); } };
tell(() => landmarkSource({ layout: "openpose" }));
const source = landmarkSource({ smoothing: null });
await source.begin({ body: async () => ({ joints: input.joints, floor_m: 0 }) });
const [first] = input.points;
tell(() => source.put(first.slice(1), undefined, 1));
tell(() => source.put([[NaN, 0, 0], ...first.slice(1)], undefined, 2));
tell(() => source.put(first.map(() => [0, 0, 0]), undefined, 3));
for (let frame = 0; frame < 30; frame++) tell(() => source.put(input.swapped, undefined, 4 + frame));
tell(() => source.put(first, undefined, 90));
console.log(JSON.stringify(told));
"""


def clip(body: BodyModel, layout: str, frames: int = 24) -> np.ndarray:
    """Points (F, N, 3) of a squat, which bends everything."""
    poses = read_motion(find_motions(("squat",))[0]).poses
    return person(body, poses[:: max(1, len(poses) // frames)][:frames], layout)


def asked(body: BodyModel, points: np.ndarray, **more: object) -> dict[str, object]:
    return {"points": points.tolist(), "joints": body.rest_joints().tolist(), "floor_m": -0.9, **more}


@pytest.mark.parametrize("layout", ["mediapipe", "coco"])
@pytest.mark.parametrize(
    "smoothing", [None, {"minCutoff": 1.2, "beta": 0.8, "dCutoff": 0.9}], ids=["plain", "filtered"]
)
def test_poses_are_those_of_the_service(
    body: BodyModel, rng: np.random.Generator, layout: str, smoothing: dict[str, float] | None, tmp_path: Path
):
    points = clip(body, layout) + rng.normal(scale=0.004, size=(1, 1, 3))
    visibility = np.where(rng.random(points.shape[:2]) < 0.1, 0.4, 0.9)
    told = {"layout": layout, "smoothing": smoothing, "visibility": visibility.tolist()}
    got = answer_of(STREAM, asked(body, points, **told), tmp_path)
    assert got["early"] is None
    euro = OneEuro(smoothing["minCutoff"], smoothing["beta"], smoothing["dCutoff"]) if smoothing else None
    stream = LandmarkPoses(layout=layout, rest_joints=body.rest_joints(), smoothing=euro)
    want = [stream(one, dt_s=DT_S, visibility=seen) for one, seen in zip(points, visibility, strict=True)]
    found = np.reshape(got["poses"], (-1, 24, 3))
    assert_allclose(rotvec_to_matrix(found), rotvec_to_matrix(np.array(want)), rtol=0.0, atol=1e-6)


def test_the_lower_foot_stands_on_the_floor(body: BodyModel, tmp_path: Path):
    points = clip(body, "mediapipe")
    got = answer_of(STREAM, asked(body, points, layout="mediapipe", smoothing=None), tmp_path)
    joints = body.rest_joints()
    turns, ways = bone_transforms(rotvec_to_matrix(np.reshape(got["poses"], (-1, 24, 3))), joints, PARENTS)
    low = np.array(got["trans"])[:, 1]
    rises = [(turns[:, one] @ joints[one] + ways[:, one] - joints[one])[:, 1] + low for one in (7, 8)]
    assert_allclose(np.min(rises, axis=0), 0.9, rtol=0.0, atol=1e-6)  # soles are that far below the origin


def test_what_is_no_person_is_refused_in_words(body: BodyModel, tmp_path: Path):
    points = clip(body, "mediapipe", 2)
    swapped = points[0].copy()
    for left in (7, 11, 13, 15, 23, 25, 27, 29, 31):
        swapped[[left, left + 1]] = swapped[[left + 1, left]]
    told = answer_of(REFUSALS, asked(body, points, swapped=swapped.tolist()), tmp_path)
    assert "mediapipe or coco" in told[0] and "33 points" in told[1] and "finite" in told[2]
    assert "apart" in told[3]
    assert told[4:-2] == [""] * 29 and "left and right look swapped" in told[-2] and told[-1] == ""
