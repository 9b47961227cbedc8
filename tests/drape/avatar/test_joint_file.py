"""Garments with joints of their own on a character's rig: what a player shows is what was distilled."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.avatar.distilled import Distilled, DrapedClip, distil, pelvis_places
from drape.avatar.file_skeleton import FileRig
from drape.avatar.joint_file import Jointed, add_clip, node_motions
from drape.avatar.rig_file import add_nodes
from drape.avatar.rig_motion import RigClip, RigMotion, rig_motion
from drape.avatar.wearer import Wearer, read_wearer
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.export.glb_file import GlbFile
from drape.garment.cache import Garment
from drape.geometry.rotations import quaternion_to_matrix, rotvec_to_matrix
from tests.drape.avatar.test_rig_file import strange
from tests.fixtures.characters import ARMS_DOWN_RAD, character
from tests.fixtures.glb_reader import Reader, khronos_complaints
from tests.fixtures.poses import smooth_motion

COLOUR = (0.2, 0.4, 0.7, 1.0)
FRAMES, COUNT = 20, 6


def to_world(motion: RigMotion, seen: np.ndarray, scale: float) -> np.ndarray:
    """Points (F, V, 3) [m] in the world of points ``seen`` from the pelvis, in the unit of the file."""
    at = pelvis_places(motion)
    return scale * (seen @ at[:, :, :3].swapaxes(-1, -2) + at[:, None, :, 3])


@pytest.fixture(scope="module")
def worn(body: BodyModel) -> Wearer:
    """Our body in an A-pose that is not its bind pose, in centimetres, facing -z, under an armature."""
    made = character(body, arms_rad=ARMS_DOWN_RAD, scale=100.0, yaw_rad=np.pi, change=strange)
    return read_wearer(made, name="somebody", body=body)


@pytest.fixture(scope="module")
def rig(worn: Wearer) -> FileRig:
    assert worn.file is not None
    return worn.file


def moved(worn: Wearer, rig: FileRig, seed: int) -> tuple[RigMotion, np.ndarray, np.ndarray]:
    poses, trans = smooth_motion(np.arange(FRAMES) / 10.0, seed=seed)
    return rig_motion(RigClip(*worn.to_rig(poses, trans), 30.0), worn, rig.skeleton), poses, trans


def swaying(tube: Garment, worn: Wearer, poses: np.ndarray, trans: np.ndarray, *, seed: int) -> np.ndarray:
    """The tube on the pelvis, its two halves turning about their own tops."""
    at, turn = tube.vertices.astype(np.float64), np.random.default_rng(seed).normal(0.0, 0.15, 3)
    pelvis = [part[:, JOINT_NAMES.index("pelvis")] for part in worn.body.bones(poses, trans)]
    share = np.clip(0.5 + 10.0 * at[:, :1], 0.0, 1.0)
    found = []
    for frame in range(FRAMES):
        sides = []
        for side in (-1.0, 1.0):
            top = np.array([0.1 * side, at[:, 1].max(), 0.0])
            sides.append((at - top) @ rotvec_to_matrix(side * turn * np.sin(0.5 * frame)).T + top)
        one = (1.0 - share) * sides[0] + share * sides[1]
        found.append(one @ pelvis[0][frame].T + pelvis[1][frame])
    return np.stack(found)


@pytest.fixture(scope="module")
def clips(tube: Garment, worn: Wearer, rig: FileRig) -> list[DrapedClip]:
    """Two clips: weights are fitted to the first."""
    found = []
    for seed in (0, 1):
        motion, poses, trans = moved(worn, rig, seed)
        found.append(DrapedClip(swaying(tube, worn, poses, trans, seed=seed), motion))
    return found


@pytest.fixture(scope="module")
def made(clips: list[DrapedClip], tube: Garment, worn: Wearer, rig: FileRig) -> Distilled:
    return distil(tube, clips[:1], worn, rig, count=COUNT)


def test_joints_follow_a_clip_that_the_weights_have_not_seen(
    made: Distilled, clips: list[DrapedClip], tube: Garment, worn: Wearer, rig: FileRig
):
    seen, unseen = (made.error_m(one, made.fitted(one, worn.scale), worn.scale) for one in clips)
    assert seen < 2e-3 and unseen < 4e-3
    few = distil(tube, clips[:1], worn, rig, count=1)
    assert few.error_m(clips[0], few.fitted(clips[0], worn.scale), worn.scale) > 3.0 * seen
    carried = made.error_m(clips[1], made.carried(clips[1].motion), worn.scale)
    assert unseen < 0.3 * carried < 0.02  # what nothing fits hangs on the rig


def written(layers: list[Jointed], clip: DrapedClip, worn: Wearer) -> bytes:
    """The garments on the nodes of the rig, all where ``clip`` has them."""
    file = GlbFile()
    nodes = add_nodes(file, clip.motion.skeleton)
    add_clip(file, layers, [clip.vertices] * len(layers), clip.motion, nodes, worn.scale)
    return file.to_bytes()


def test_no_vertex_has_more_joints_than_players_know(made: Distilled):
    assert ((made.weights > 0.0).sum(axis=1) <= 4).all() and (made.weights >= 0.0).all()
    assert_allclose(made.weights.sum(axis=1), 1.0, atol=1e-9)


def test_a_player_shows_what_was_distilled(made: Distilled, clips: list[DrapedClip], tube: Garment, worn: Wearer):
    clip = clips[1]
    file = Reader(written([Jointed(tube.surface, made, COLOUR)], clip, worn))
    want = to_world(clip.motion, made.placed(clip.motion, made.fitted(clip, worn.scale)), worn.scale)
    shown = file.skinned(FRAMES)[:, : tube.vertex_count] * worn.scale
    assert np.abs(shown - want).max() < 1e-4  # 16 bits of weights, float32 of metres in centimetres
    assert not any("targets" in one for one in file.json["meshes"][0]["primitives"])


def test_without_tracks_it_hangs_on_the_rig(
    made: Distilled, clips: list[DrapedClip], tube: Garment, worn: Wearer, rig: FileRig
):
    """A player that moves the character's own joints alone shows the garment carried."""
    clip = clips[1]
    file = Reader(written([Jointed(tube.surface, made, COLOUR)], clip, worn))
    own = [i for i, node in enumerate(file.json["nodes"]) if node["name"].startswith(f"{tube.name}_")]
    assert len(own) == COUNT
    channels = file.json["animations"][0]["channels"]
    file.json["animations"][0]["channels"] = [one for one in channels if one["target"]["node"] not in own]
    want = to_world(clip.motion, made.placed(clip.motion, made.carried(clip.motion)), worn.scale)
    assert np.abs(file.skinned(FRAMES)[:, : tube.vertex_count] * worn.scale - want).max() < 1e-4


def test_the_khronos_validator_has_no_complaint(
    made: Distilled, clips: list[DrapedClip], tube: Garment, worn: Wearer, tmp_path: Path
):
    content = written([Jointed(tube.surface, made, COLOUR)] * 2, clips[0], worn)
    assert khronos_complaints(content, tmp_path) == []


def test_joints_below_a_mirrored_node_turn_and_are_not_mirrored(made: Distilled, rng: np.random.Generator):
    """Rigs mirror one side of a body by a scale of -1: the turn is the nearest one."""
    mirror = np.tile(np.diag([-1.0, 1.0, 1.0, 1.0])[:3], (len(made.binds), 1, 1))
    seen = np.concatenate([rotvec_to_matrix(rng.normal(size=(COUNT, 3))), np.zeros((COUNT, 3, 1))], axis=2)
    turns = quaternion_to_matrix(node_motions(replace(made, binds=mirror), seen[None])[0][0])
    assert_allclose(np.einsum("eab,eab->e", turns, mirror[0, :, :3] @ seen[:, :, :3]), 1.0, atol=1e-6)  # as a mirror's
    assert_allclose(turns @ np.swapaxes(turns, 1, 2), np.tile(np.eye(3), (COUNT, 1, 1)), atol=1e-9)
