"""Sleeves are told from cloth that only lies beside an arm, and move as their arm does."""

from __future__ import annotations

import numpy as np

from drape.body.assets import load_body
from drape.body.skeleton import JOINT_NAMES
from drape.garment.avatars import Avatar
from drape.garment.registration import posed_by
from drape.garment.rest_pose import to_standard
from drape.garment.sleeves import sleeve_of
from drape.garment.wearer_fields import known_parameters
from tests.drape.cloth.cloth_shapes import tube
from tests.drape.garment.garment_files import shirt

BODY = load_body()
HANGING = posed_by(BODY, known_parameters(BODY, "standard", 1.3, 0.0))
JOINTS = BODY.regressor @ HANGING
SHIRT, FACES = shirt(BODY, HANGING)
TARGET = shirt(BODY, BODY.v_template)[0]


def skirt_beside_hands() -> tuple[np.ndarray, np.ndarray]:
    """A wide skirt that both hands hang by: vertices (N, 3), faces (F, 3)."""
    hand = JOINTS[JOINT_NAMES.index("left_hand")]
    unit, faces = tube(48, 24, radius_m=1.0, height_m=1.0)
    down = 1.0 - unit[:, 1:2]
    points = (hand[0] - 0.08 + 0.1 * (down - 0.4)) * unit * [1.0, 0.0, 1.0] + [0.0, hand[1] + 0.25, hand[2]]
    return points - 0.6 * down * [0.0, 1.0, 0.0], faces


def test_a_skirt_that_hands_hang_by_is_no_sleeve_and_keeps_its_shape():
    vertices, faces = skirt_beside_hands()
    both = np.concatenate([SHIRT, vertices])
    joined = np.concatenate([FACES, faces + len(SHIRT)])
    found = sleeve_of(both, joined, JOINTS, HANGING)
    assert not found[len(SHIRT) :].any()
    assert (found[: len(SHIRT)] > 0).any()
    moved = to_standard(both, joined, Avatar(HANGING, BODY.faces, 0.0, "hanging"), BODY).vertices[len(SHIRT) :]
    assert np.linalg.norm(moved - vertices, axis=1).max() < 0.05


def test_a_cuff_below_the_crotch_is_no_part_of_its_robe_s_skirt():
    hands = JOINTS[[JOINT_NAMES.index(f"{side}_wrist") for side in ("left", "right")]]
    skirt, skirt_faces = tube(48, 24, radius_m=0.22, height_m=0.9)
    skirt = skirt + np.array([0.0, -0.45 + JOINTS[0, 1], JOINTS[0, 2]])
    vertices = np.concatenate([SHIRT, skirt])
    bridge = [[int(SHIRT[:, 1].argmin()), len(SHIRT), len(SHIRT) + 1]]
    faces = np.concatenate([FACES, skirt_faces + len(SHIRT), bridge])
    found = sleeve_of(vertices, faces, JOINTS, HANGING)
    assert vertices[np.isin(found, (1, 2)), 1].min() < hands[:, 1].max() + 0.05
    loose = to_standard(vertices, faces, Avatar(HANGING, BODY.faces, 0.0, "hanging"), BODY).loose
    assert loose.max() == 1.0 and not loose[found > 0].any()


def test_sleeves_are_the_cloth_round_the_arms_of_their_side():
    found = sleeve_of(SHIRT, FACES, JOINTS, HANGING)
    out = np.abs(TARGET[:, 0]) > np.quantile(np.abs(TARGET[:, 0]), 0.97)
    assert set(found[out & (TARGET[:, 0] > 0.0)]) == {1} and set(found[out & (TARGET[:, 0] < 0.0)]) == {2}
    assert not found[np.abs(TARGET[:, 0]) < 0.12].any()


def test_a_button_near_a_sleeve_is_of_that_sleeve_and_another_is_not():
    on = SHIRT[TARGET[:, 0].argmax()] + [0.01, 0.0, 0.0]
    off = SHIRT[np.abs(TARGET[:, 0]).argmin()] + [0.0, 0.0, 0.01]
    corner = 0.003 * np.eye(3)
    vertices = np.concatenate([SHIRT, on + corner, off + corner])
    faces = np.concatenate([FACES, len(SHIRT) + np.array([[0, 1, 2], [3, 4, 5]])])
    found = sleeve_of(vertices, faces, JOINTS, HANGING)
    assert found[-6:].tolist() == [1, 1, 1, 0, 0, 0]
