"""Vertices of posed patches: the formula in plain float64, points between vertices, messages, refusals."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from drape.errors import DrapeError, InputError
from drape.garment.cache import Garment
from drape.geometry import jets, meshes
from drape.geometry.rotations import rotvec_to_matrix
from drape.wire import messages as wire
from drape.wire.jets import JetFrame
from drape.wire.layout import HEADER_BYTES, JetLayout, pack_layout, unpack_layout
from tests.fixtures.packed import garment


def layout_of(whole: Garment) -> JetLayout:
    charts = whole.chart_patch, whole.chart_weight, whole.chart_uv
    return JetLayout(whole.patch_rotation, whole.patch_centre, whole.patch_scale, whole.vertices, *charts)


def posed(layout: JetLayout, *, seed: int = 0, size: float = 0.1) -> JetFrame:
    """Patches that are moved and bent each in its own way."""
    generator, count = np.random.default_rng(seed), layout.patch_count
    turns = rotvec_to_matrix(size * generator.normal(size=(count, 3))) @ layout.rotation
    centre = layout.centre + size * generator.normal(size=(count, 3))
    jet = size * generator.normal(size=(count, 45))
    return JetFrame(1, 0.0, 0.0, np.array([5.0, 1.0, -2.0]), jet, turns, centre)


def rigid(layout: JetLayout, turn: np.ndarray, way: np.ndarray) -> JetFrame:
    """All patches moved together, none bent."""
    jet = np.zeros((layout.patch_count, 45))
    return JetFrame(1, 0.0, 0.0, np.zeros(3), jet, turn @ layout.rotation, layout.centre @ turn.T + way)


@pytest.mark.parametrize("kind", ["tube", "tank"])
def test_vertices_are_the_weighted_mean_over_charts(kind: str, tube: Garment):
    whole = tube if kind == "tube" else garment(kind)
    layout = layout_of(whole)
    frame = posed(layout)
    local = whole.chart_local()  # of the garment, not of the layout: by rest jet and residual
    for vertex in range(0, len(whole.vertices), 97):
        expected = np.zeros(3)
        for chart in range(whole.chart_patch.shape[1]):
            patch, weight = whole.chart_patch[vertex, chart], float(whole.chart_weight[vertex, chart])
            uv = whole.chart_uv[vertex, chart].astype(np.float64)
            bent = whole.patch_scale[patch] * jets.evaluate_jet(frame.jet[patch], uv)
            place = frame.rotation[patch] @ (local[vertex, chart] + bent) + frame.centre[patch]
            expected += weight * place
        assert_allclose(layout.vertices(frame)[vertex], expected + frame.root, rtol=0, atol=2e-6)


def test_patches_at_rest_give_the_rest_mesh():
    layout = layout_of(garment("tank"))
    still = rigid(layout, np.eye(3), np.zeros(3))
    assert_allclose(layout.vertices(still), layout.rest, rtol=0, atol=1e-6)


def test_points_on_triangles_follow_a_rigid_motion_exactly():
    whole = garment("tank")
    layout, turn, way = layout_of(whole), rotvec_to_matrix(np.array([0.4, -1.0, 2.0])), np.array([0.3, 0.1, -0.2])
    finer, faces = layout.subdivided(whole.faces.astype(np.int64))
    count = len(whole.vertices)
    assert len(faces) == 4 * len(whole.faces) and faces.max() == len(finer.rest) - 1
    expected, _, _ = meshes.subdivide(layout.rest.astype(np.float64), whole.faces)
    assert_allclose(finer.rest, expected, rtol=0, atol=1e-6)
    assert_allclose(finer.vertices(rigid(layout, turn, way)), expected @ turn.T + way, rtol=0, atol=2e-6)
    assert_allclose(finer.chart_weight.sum(axis=1), 1.0, rtol=0, atol=1e-5)
    frame = posed(layout)
    assert_allclose(finer.vertices(frame)[:count], layout.vertices(frame), rtol=0, atol=1e-6)


def test_points_between_vertices_lie_on_the_jets_and_not_on_the_chords():
    """One patch bent to h = u^2: a point in the middle of a long edge lies a sagitta off the chord."""
    whole = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]], dtype=np.float32)
    uv = whole[:, None, :2] / 0.1
    one = JetLayout(
        np.eye(3)[None], np.zeros((1, 3)), np.full(1, 0.1), whole, np.zeros((3, 1), int), np.ones((3, 1)), uv
    )
    jet = np.zeros((1, 45))
    jet[0, 30 + 3] = 1.0  # h: u^2
    frame = JetFrame(1, 0.0, 0.0, np.zeros(3), jet, np.eye(3)[None], np.zeros((1, 3)))
    shares = np.array([[0.5, 0.5, 0.0], [0.25, 0.75, 0.0], [1 / 3, 1 / 3, 1 / 3]])
    got = one.on(np.tile([0, 1, 2], (3, 1)), shares)
    u = got.rest[:, 0].astype(float) / 0.1
    expected = np.column_stack([got.rest[:, :2], 0.1 * u**2])
    assert_allclose(got.vertices(frame), expected, rtol=0, atol=1e-7)
    assert got.chart_patch.shape == (3, 1), "the same patch of three corners is one chart"


def test_triangles_agree_at_the_edge_between_them():
    whole = garment("tank")
    layout, faces = layout_of(whole), whole.faces.astype(np.int64)
    sides = faces[:400]
    one = layout.on(sides, np.tile([0.3, 0.7, 0.0], (len(sides), 1)))
    opposite = np.random.default_rng(1).integers(0, len(layout.rest), len(sides))
    other = layout.on(np.column_stack([opposite, sides[:, 1], sides[:, 0]]), np.tile([0.0, 0.7, 0.3], (len(sides), 1)))
    frame = posed(layout)
    assert_allclose(one.vertices(frame), other.vertices(frame), rtol=0, atol=1e-6)


def test_refining_twice_keeps_few_charts():
    whole = garment("tank")
    once, faces = layout_of(whole).subdivided(whole.faces.astype(np.int64))
    twice, _ = once.subdivided(faces)
    assert twice.chart_patch.shape[1] <= 12
    rest = rigid(twice, np.eye(3), np.zeros(3))
    assert_allclose(twice.vertices(rest), twice.rest, rtol=0, atol=2e-6)


def test_layout_survives_the_wire(tube: Garment):
    sent = layout_of(tube)
    message = pack_layout(sent)
    got = unpack_layout(message)
    assert len(message) % 4 == 0 and wire.message_kind(message) == wire.LAYOUT
    for item in fields(JetLayout):
        wanted = np.asarray(getattr(sent, item.name))
        assert_array_equal(getattr(got, item.name), wanted.astype(np.float32) if wanted.dtype.kind == "f" else wanted)
    frame = posed(sent)
    assert_allclose(got.vertices(frame), sent.vertices(frame), rtol=0, atol=1e-6)


@given(message=st.binary(max_size=300))
def test_noise_is_refused(message: bytes):
    with pytest.raises(DrapeError):
        unpack_layout(message)


def test_what_does_not_fit_is_refused(tube: Garment):
    layout = layout_of(tube)
    message = bytearray(pack_layout(layout))
    with pytest.raises(InputError, match="for 12 patches and 216 vertices of 4 charts"):
        unpack_layout(bytes(message[:-4]))
    message[-2:] = (99).to_bytes(2, "little")
    with pytest.raises(InputError, match=r"patches in \[0, 12\), got 99"):
        unpack_layout(bytes(message))
    message[5] = wire.JETS
    with pytest.raises(InputError, match="expected kind 5, got kind 4"):
        unpack_layout(bytes(message))
    frame = posed(layout)
    with pytest.raises(InputError, match="expected 12, as in the layout, got 11"):
        layout.vertices(replace(frame, jet=frame.jet[1:]))
    for corners, shares, word in (
        (np.array([[0, 1, 216]]), np.ones((1, 3)) / 3, "vertices in"),
        (np.array([[0, 1]]), np.ones((1, 3)) / 3, "corners"),
        (np.array([[0, 1, 2]]), np.ones((2, 3)) / 3, "shares"),
    ):
        with pytest.raises(InputError, match=word):
            layout.on(corners, shares)
    assert HEADER_BYTES == 24
