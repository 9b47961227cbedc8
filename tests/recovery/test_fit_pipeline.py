"""The whole way from a draped target to its pattern."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.assets import load_body
from drape.errors import InputError
from recovery.drape.pipeline import DrapeOptions, drape_pattern
from recovery.drape.placement import scaled
from recovery.fit.compare import pattern_error
from recovery.fit.optimise import FitOptions
from recovery.fit.pipeline import recover_pattern
from recovery.pattern.bases import tshirt
from tests.recovery.pattern_setup import default_measurements

COARSE = DrapeOptions(edge_length_m=0.05, grid_m=0.02)


@pytest.mark.slow
def test_a_larger_base_finds_the_pattern_of_a_drape():
    """Larger by 7 %: grading and two rounds bring control points within 1 mm on a coarse mesh, areas 0.5 %."""
    body, truth = load_body(), tshirt(default_measurements())
    target = drape_pattern(truth, body, COARSE)
    lines: list[str] = []
    base = scaled(truth, 1.07)
    found = recover_pattern(
        target.nodes,
        target.mesh.faces,
        base,
        body,
        drape=COARSE,
        fit=FitOptions(iterations=0, closing=3),
        meshes_m=(0.05, 0.05),
        report=lines.append,
    )
    before, after = pattern_error(base, truth), pattern_error(found.fitted.pattern, truth)
    assert before.controls_m.mean() > 0.01 > 0.001 > after.controls_m.mean()
    assert np.abs(after.areas).mean() < 0.005
    # What is returned is of one mesh, and grading says what it made of the base.
    assert len(found.fitted.nodes) == found.start.mesh.node_count == found.search.mesh.node_count
    assert_allclose(found.graded.widths * 1.07, 1.0, atol=0.03)
    assert found.fabric.describe() == "jersey, within 5 % in everything"
    assert len(found.matches) == 4 and found.holes == []
    assert [line.split()[0] for line in lines] == ["symmetry"] * 4 + ["graded", "search", "round", "round", "fitted"]
    with pytest.raises(InputError, match="meshes_m"):
        recover_pattern(target.nodes, target.mesh.faces, base, body, drape=COARSE, meshes_m=())
    with pytest.raises(InputError, match="at rest to start from"):
        recover_pattern(target.nodes, target.mesh.faces, base, body, drape=replace(COARSE, iteration_limit=0))
