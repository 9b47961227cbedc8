"""The benchmark of swing: its clip, and its simulator against a fall without a body."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from benchmarks.cases import FPS
from benchmarks.judge.simulator import (
    AIR_KG_M3,
    SLIP_M,
    MovingSkin,
    SimulatedCloth,
    SimulatedMotion,
    grip,
    simulate,
    slow_down,
)
from benchmarks.measure.hem import SETTLED_M, swinging
from benchmarks.swing import FALL_M, MADE, SPIN, made_clip
from drape.body.assets import load_body
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.exact.newton import Band, Cloth, Descent
from tests.drape.geometry.geometry_shapes import icosphere
from tests.drape.live.swing_setup import strip


def test_the_body_turns_as_it_is_told():
    clip = made_clip(SPIN, load_body(), FPS, 4.5)
    yaw = np.unwrap(clip.poses[:, 0, 1])
    assert_allclose(yaw[-1] / (2.0 * np.pi), 0.5 * 0.75 + 1.25 + 0.5 * 0.3, rtol=1e-2)
    assert_allclose(np.diff(yaw)[45:70] * FPS, 2.0 * np.pi, rtol=1e-6)
    assert (np.diff(yaw)[:14] == 0.0).all() and (np.diff(yaw)[-40:] == 0.0).all()


def test_made_ways_come_to_a_stand():
    ways = {name: made_clip(name, load_body(), 120.0, 3.0).trans for name in MADE if name != SPIN}
    ends = {"stop": [0.0, 0.0, 1.33], "step": [0.0, 0.3, 0.3], "fall": [0.0, -FALL_M - 0.5 * 0.12 * 4.43, 0.0]}
    for name, way in ways.items():
        assert_allclose(way[-1], ends[name], atol=0.02)
        assert not np.diff(way[-120:], axis=0).any() and not way[:60].any()


def test_a_hem_that_swings_has_its_period_and_time():
    time_s = np.arange(300) / 100.0
    way = 0.1 * np.exp(-2.0 * time_s) * np.cos(2.0 * np.pi * time_s / 0.8)
    told = swinging(np.ones((12, 1)) * np.array([0.0, 0.0, 1.0]) * way[:, None, None], 100.0)
    assert_allclose(told["period_s"], 0.8, atol=0.03)
    assert_allclose(told["over"], np.exp(-2.0 * 0.4), atol=0.05)
    assert_allclose(told["settle_s"], np.log(0.1 / SETTLED_M) / 2.0, atol=0.2)
    still = swinging(np.zeros((20, 12, 3)), 100.0)
    assert still["settle_s"] == 0.0 and np.isnan(still["period_s"])


def test_cloth_far_from_a_body_falls():
    body = load_body()
    rest, faces = strip(0.1)
    mesh, material = ClothMesh.from_rest(rest, faces), Material()
    ahead = rest + np.array([3.0, 0.0, 0.0])
    step = Descent(
        Cloth.of(mesh, material, None),
        BodyContact(body.faces, body.vertex_count),
        body.posed_vertices(np.zeros((1, 24, 3)))[0],
        ahead,
        drawn=Band(ahead, mesh.vertex_mass(material) * FPS**2),
    ).run(20, 1e-6)
    assert step.at_rest
    assert_allclose(step.x, ahead - np.array([0.0, 9.81 / FPS**2, 0.0]), atol=1e-5)


def test_air_slows_what_moves_across():
    rest, faces = strip(0.1)
    mesh, material = ClothMesh.from_rest(rest, faces), Material()
    along = np.tile([0.0, 1.0, 0.0], (len(rest), 1))
    still, damped = (SimulatedCloth(mesh, material, 0.0, rate) for rate in (0.0, 3.0))
    assert_allclose(slow_down(along, rest, still, FPS), along)
    across = np.tile([0.0, 0.0, 2.0], (len(rest), 1))
    slow = AIR_KG_M3 / 0.2 * 2.0 / FPS
    assert_allclose(slow_down(across, rest, still, FPS), across / (1.0 + slow))
    assert_allclose(slow_down(along, rest, damped, FPS), along / (1.0 + 3.0 / FPS))


def test_friction_pulls_back_along_the_skin_with_its_share_of_the_contact():
    rest, faces = strip(0.1)
    mesh, material = ClothMesh.from_rest(rest, faces), Material()
    ball, corners = icosphere(4, radius_m=0.1)
    way_out = rest + np.array([0.0, 0.0, 0.2])
    x = 0.1015 * (way_out / np.linalg.norm(way_out, axis=1, keepdims=True))  # within the gap
    one = Descent(Cloth.of(mesh, material, None), BodyContact(corners, len(ball)), ball, x)
    around, _ = one.around(x)
    normal = around.normal / np.linalg.norm(around.normal, axis=1, keepdims=True)
    depth = float(one.problem.constants.gap) - ((x - around.point) * normal).sum(axis=1)
    assert (depth > 0.0).all()
    across = np.cross(normal, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    for way, share in ((5.0 * SLIP_M, 1.0), (0.5 * SLIP_M, 0.5)):
        place, spring = grip(one, x, x - way * across + 0.01 * normal, 0.4)
        assert_allclose(
            spring[:, None] * (place - x), -share * 0.4 * (one.problem.contact_n_per_m * depth)[:, None] * across,
            rtol=1e-6, atol=1e-12,
        )  # fmt: skip


def test_the_skin_carries_what_lies_on_it_round_with_the_body():
    body, clip = load_body(), made_clip(SPIN, load_body(), FPS, 1.2)
    skin = MovingSkin(SimulatedMotion(body, clip.poses, clip.trans, FPS))
    near = skin.posed[28, ::500]
    yaw = clip.poses[29, 0, 1] - clip.poses[28, 0, 1]
    root = body.rest_joints()[0]
    turn = np.array([[np.cos(yaw), 0.0, np.sin(yaw)], [0.0, 1.0, 0.0], [-np.sin(yaw), 0.0, np.cos(yaw)]])
    assert abs(yaw) > 0.05
    assert_allclose(skin.carried(near, 29), (near - root) @ turn.T + root, atol=1e-9)


def test_what_touches_nothing_falls_frame_by_frame():
    body, (rest, faces) = load_body(), strip(0.1)
    sheet = SimulatedCloth(ClothMesh.from_rest(rest, faces), Material(), 0.4, 0.0)
    motion = SimulatedMotion(body, np.zeros((5, 24, 3)), np.zeros((5, 3)), FPS)
    found, _ = simulate(sheet, motion, rest + np.array([3.0, 0.0, 0.0]), None)
    fallen = (found - found[0])[..., 1].mean(axis=1)
    # Implicit Euler, of a strip that lies across its way but is slowed by air.
    n = np.arange(5)
    assert_allclose(fallen, -9.81 / FPS**2 * n * (n + 1) / 2.0, rtol=0.05)
