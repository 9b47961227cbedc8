"""The waist of a drape laid on that of its target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.body.assets import load_body
from recovery.drape.pipeline import DrapeOptions, drape_pattern
from recovery.fit.belt import held_as_target
from recovery.fit.cloth import named
from recovery.fit.contours import match_contours, open_contours
from recovery.fit.objective import nearest_on_line
from recovery.pattern.bases import skirt
from recovery.sim.sdf import GridDistance
from tests.recovery.pattern_setup import default_measurements

LOWER_M = 0.01


def test_the_nearest_point_of_a_closed_line_is_on_its_last_segment_too():
    square = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]], dtype=torch.float64)
    points = torch.tensor([[-0.1, 0.25, 0.3], [0.6, -0.2, 0.0], [2.0, 2.0, 0.0]], dtype=torch.float64)
    best, t = nearest_on_line(points, square)
    found = square[best] + t[:, None] * (torch.roll(square, -1, dims=0) - square)[best]
    assert_allclose(found, [[0.0, 0.25, 0.0], [0.6, 0.0, 0.0], [1.0, 1.0, 0.0]], atol=1e-15)


@pytest.mark.slow
def test_a_belt_is_held_where_the_waist_of_the_target_is():
    body = load_body()
    draped = drape_pattern(skirt(default_measurements()), body, DrapeOptions(edge_length_m=0.1, grid_m=0.02))
    own = open_contours(draped.nodes, draped.mesh.faces)
    # The target's waist is lower and wider: there the hips are.
    held = draped.rest.held
    middle = draped.nodes[held].mean(axis=0)
    lower = middle + 1.02 * (draped.nodes - middle) - [0.0, LOWER_M, 0.0]
    there = open_contours(lower, draped.mesh.faces)
    matches, _ = match_contours(own, there, body.joints_template)
    skin = GridDistance.from_mesh(body.v_template, body.faces, spacing_m=0.02)
    cloth = named("jersey")
    found = held_as_target(draped, matches, there, skin, cloth)
    assert found.at_rest and np.array_equal(found.rest.held, held)
    target = next(match.target for match in matches if np.isin(held, own[match.source].loop).all())
    waist = torch.from_numpy(there[target].points)
    best, t = nearest_on_line(torch.from_numpy(found.nodes[held]), waist)
    nearest = waist[best] + t[:, None] * (torch.roll(waist, -1, dims=0) - waist)[best]
    assert_allclose(found.nodes[held], nearest, atol=1e-12)
    free = np.setdiff1d(np.arange(len(found.nodes)), held)
    assert 0.5 * LOWER_M < (draped.nodes - found.nodes)[free, 1].mean() < 1.5 * LOWER_M
    # Laid on its own waist it stays; without belt or counterpart nothing is moved.
    same = held_as_target(draped, match_contours(own, own, body.joints_template)[0], own, skin, cloth)
    assert np.abs(same.nodes - draped.nodes).max() < 1e-4
    loose = replace(draped, rest=draped.rest._replace(held=np.zeros(0, dtype=np.int64)))
    assert held_as_target(loose, matches, there, skin, cloth) is loose
    assert held_as_target(draped, [], there, skin, cloth) is draped
