"""Vertices of posed jets as the engine makes them: the formula in float64, whatever the index's type."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.geometry import jets
from drape.geometry.rotations import rotvec_to_matrix
from drape.graph.blend import PosedJets, Tiles, blend
from drape.graph.feeds import garment_feed
from drape.graph.packing import PackedGarment, pack_garment
from tests.fixtures.garments import tube

TERMS = 4 * 18  # of a vertex


def blended(garment: PackedGarment, *jets: np.ndarray) -> np.ndarray:
    vertices = np.empty((garment.vertex_count, 3), np.float32)
    blend(PosedJets(*jets), Tiles.of(garment), vertices)
    return vertices


@pytest.mark.parametrize("width", [jets.JET_COUNT, jets.FULL_COUNT])
def test_a_vertex_is_what_its_charts_say_by_their_weights(width: int):
    feed, draw = garment_feed(tube()), np.random.default_rng(5)
    patches = len(feed["patch_scale"])
    packed = pack_garment(feed, np.zeros((patches, 5)))
    jet = draw.uniform(-0.1, 0.1, (patches, width)).astype(np.float32)
    rotation = rotvec_to_matrix(draw.normal(size=(patches, 3))).astype(np.float32)
    centre = draw.uniform(-1.0, 1.0, (patches, 3)).astype(np.float32)
    found = blended(packed, jet, rotation, centre)

    charts = feed["chart_patch"]
    moved = np.stack(jets.unpack(jets.full(jet.astype(np.float64))), axis=1)[charts] @ feed["chart_basis"][..., None]
    local = feed["chart_local"] + feed["patch_scale"][charts][..., None] * moved[..., 0]
    said = (rotation.astype(np.float64)[charts] @ local[..., None])[..., 0] + centre[charts]
    want = np.sum(feed["chart_weight"][..., None] * said, axis=1)
    assert found.dtype == np.float32
    assert_allclose(found, want, rtol=0, atol=TERMS * np.spacing(np.float32(1.0)))

    assert packed.vertex_charts.dtype == np.uint16
    large = replace(packed, vertex_charts=packed.vertex_charts.astype(np.int32))
    for made in (packed, large):
        assert_array_equal(blended(made, jet, rotation, centre), found)
