"""The whole way from a draped target to its pattern."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.errors import InputError
from drape.garment.contours import match_contours, open_contours
from recovery.drape.pattern_drape import SewingOptions, drape_pattern, hanging
from recovery.drape.placement import scale_pattern
from recovery.fit import starts
from recovery.fit.forward import hold_as_target
from recovery.fit.laying import EDGE_M, Shown
from recovery.fit.objective import TargetSurface, nearest_on_line
from recovery.fit.optimise import FitOptions
from recovery.fit.outcome import Recovered
from recovery.fit.rounds import RoundsOptions, _Rounds, recover_pattern
from recovery.pattern.bases import skirt, tshirt
from recovery.run.sew_anew import sew_anew
from recovery.sim.skin_contact import GridDistance
from tests.recovery.pattern_error import pattern_error
from tests.recovery.pattern_setup import default_measurements

COARSE = SewingOptions(edge_length_m=0.05, grid_m=0.02)


@pytest.mark.slow
@pytest.mark.long
def test_a_larger_base_finds_the_pattern_of_a_drape(body):
    """Larger by 7 %: gradings and three closing steps bring control points within 1 mm, areas 0.5 %."""
    truth = tshirt(default_measurements())
    target = drape_pattern(truth, body, COARSE)
    base = scale_pattern(truth, 1.07)
    found = recover_pattern(
        TargetSurface.from_mesh(*target.surface),
        base,
        body,
        RoundsOptions(COARSE, FitOptions(iterations=0, closing=3), meshes_m=(0.05,)),
    )
    before, after = pattern_error(base, truth), pattern_error(found.fitted.pattern, truth)
    assert before.controls_m.mean() > 0.01 > 0.001 > after.controls_m.mean()
    assert np.abs(after.areas).mean() < 0.005
    assert len(found.matches) == 4 and found.holes == []
    # Grading says what it made of the base, in two steps.
    assert_allclose(found.graded.widths * 1.07, 1.0, atol=0.03)
    assert_allclose(found.graded.heights * 1.07, 1.0, atol=0.03)


@pytest.mark.slow
@pytest.mark.long
def test_rounds_go_on_from_each_other_in_the_fabric_that_is_named(body, tmp_path):
    """A skirt of another fabric than the base's: a second round has its own mesh and drape."""
    truth = skirt(default_measurements())
    coarse = replace(COARSE, edge_length_m=0.08, fabric="crisp")
    target = drape_pattern(truth, body, coarse)
    lines: list[str] = []
    found = recover_pattern(
        TargetSurface.from_mesh(*target.surface),
        scale_pattern(truth, 1.05),
        body,
        RoundsOptions(
            coarse, FitOptions(iterations=0, closing=2), meshes_m=(0.08, 0.07), state_file=tmp_path / "state.npz"
        ),
        report=lines.append,
    )
    told = [line.split()[0] for line in lines if not line.startswith("symmetry")]
    assert told == ["graded", "search", "round", "round", "fitted"]
    assert found.fabric == "crisp"
    first, second = found.rounds
    assert first.start.mesh.node_count < second.start.mesh.node_count
    assert first.fitted.cloth == hanging("crisp") == second.fitted.cloth
    best = min(found.rounds, key=lambda one: one.rank)
    assert (
        (found.fitted.history == best.fitted.history).all()
        and found.fitted.pattern.material == "crisp 200 g/m²"
        and len(found.fitted.nodes) == found.search.mesh.node_count
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["state.npz", "state_1.npz"]


def test_options_of_rounds_that_lead_nowhere_are_refused():
    with pytest.raises(InputError, match="meshes_m"):
        RoundsOptions(meshes_m=())
    with pytest.raises(InputError, match="more than 0"):
        RoundsOptions(reach_m=-0.1)
    assert RoundsOptions(COARSE).lengths_m(laid=False) == [0.05] * 3
    assert RoundsOptions(COARSE).lengths_m(laid=True) == [EDGE_M]
    assert RoundsOptions(COARSE, meshes_m=(0.02, 0.05)).lengths_m(laid=True) == [0.02, EDGE_M]


@pytest.mark.long
def test_a_graded_pattern_that_sticks_on_one_mesh_is_draped_on_the_next(body, monkeypatch: pytest.MonkeyPatch):
    pattern = skirt(default_measurements())
    very_coarse = SewingOptions(edge_length_m=0.12, grid_m=0.04)
    skin = very_coarse.skin(body.posed_vertices(np.zeros((1, 24, 3)))[0], body.faces)
    lengths = []

    def stopped_at_first(pattern, body, drape, **given):
        lengths.append(drape.edge_length_m)
        first = len(lengths) == 1
        return drape_pattern(pattern, body, replace(drape, iteration_limit=0) if first else drape, **given)

    monkeypatch.setattr(starts, "drape_pattern", stopped_at_first)
    start = starts.DrapeStart(body, very_coarse, None, skin, ("trunk", "trunk"))
    assert starts.drape_at_rest(pattern, start).at_rest
    assert_allclose(lengths, [0.12, 0.93 * 0.12])
    monkeypatch.undo()
    with pytest.raises(InputError, match=r"graded pattern: .* N left at a node, on the best of 4 meshes"):
        starts.drape_at_rest(pattern, replace(start, drape=replace(very_coarse, iteration_limit=0)))
    # One that no arm goes through is tried on a finer mesh and then on every one; the first of equals is taken.
    lengths.clear()
    monkeypatch.setattr(starts, "drape_pattern", stopped_at_first)
    found = starts.drape_worn(pattern, replace(start, parts=("left_arm",)))
    assert_allclose(lengths, 0.12 * np.array([1.0, 0.6, 0.93, 1.07, 0.87]))
    assert found.at_rest and replace(start, parts=("left_arm",)).lost(found) == ("left_arm",)
    # What is mended is judged as it is then: no other mesh is tried.
    lengths.clear()
    assert starts.drape_worn(pattern, start, mended=lambda one: found) is found and len(lengths) == 1


def test_what_a_coarse_mesh_loses_is_draped_on_a_finer_one_from_then_on():
    options = SewingOptions(edge_length_m=0.05)
    for length, needed in ((0.03, 0.03), (0.0435, np.inf), (0.05, np.inf)):
        assert starts.needed_length(cast(Any, SimpleNamespace(figures={"edge_length_m": length})), options) == needed


@pytest.mark.parametrize(
    ("second", "taken"), [({}, 2), ({"at_rest": False}, 1), ({"lost": ("left_arm",)}, 1), (None, 1)]
)
def test_the_last_grading_that_is_worn_and_at_rest_is_searched(second, taken):
    """A neckline that is narrower than the body narrows the chest with it, and graded again narrows it again."""

    def drape(at_rest=True, lost=()):
        return SimpleNamespace(at_rest=at_rest, lost=lost)

    def graded(before, draped):
        if before == 1 and second is None:
            raise InputError("target", expected="half the size", got="less", cure="Take another base.")
        return before + 1, drape(**second) if before == 1 else drape()

    start = SimpleNamespace(lost=lambda draped: draped.lost)
    task = SimpleNamespace(graded=graded, start=lambda options: start, drape=None)
    best, worn = _Rounds.best_graded(*cast(Any, (task, 0, drape(), 2)))
    assert best == taken and worn.at_rest and not start.lost(worn)


def test_a_pattern_that_no_mesh_can_be_sewn_of_is_refused(body, monkeypatch: pytest.MonkeyPatch):
    def refused(*given, **more):
        raise InputError("stitch", expected="edges that meet", got="a body", cure="Check it.")

    monkeypatch.setattr(starts, "drape_pattern", refused)
    with pytest.raises(InputError, match="edges that meet"):
        starts.drape_worn(skirt(default_measurements()), starts.DrapeStart(body, SewingOptions(), None, None))


@pytest.mark.long
def test_a_belt_is_held_where_the_waist_of_the_target_is(body):
    lower_m = 0.01
    draped = drape_pattern(skirt(default_measurements()), body, SewingOptions(edge_length_m=0.1, grid_m=0.02))
    own = open_contours(*draped.surface)
    # The target's waist is lower and wider: there the hips are.
    held = draped.rest.held
    middle = draped.nodes[held].mean(axis=0)
    lower = middle + 1.02 * (draped.nodes - middle) - [0.0, lower_m, 0.0]
    there = open_contours(lower, draped.mesh.faces)
    matches, _ = match_contours(own, there, body.joints_template)
    skin = GridDistance.from_mesh(body.v_template, body.faces, spacing_m=0.02)
    cloth = hanging("jersey")
    found = hold_as_target(draped, matches, there, skin, cloth)
    assert found.at_rest and np.array_equal(found.rest.held, held)
    target = next(match.target for match in matches if np.isin(held, own[match.source].loop).all())
    waist = torch.from_numpy(there[target].points)
    best, t = nearest_on_line(torch.from_numpy(found.nodes[held]), waist)
    nearest = waist[best] + t[:, None] * (torch.roll(waist, -1, dims=0) - waist)[best]
    assert_allclose(found.nodes[held], nearest, atol=1e-12)
    free = np.setdiff1d(np.arange(len(found.nodes)), held)
    assert 0.5 * lower_m < (draped.nodes - found.nodes)[free, 1].mean() < 1.5 * lower_m
    # Laid on its own waist it stays; without belt or counterpart nothing is moved.
    same = hold_as_target(draped, match_contours(own, own, body.joints_template)[0], own, skin, cloth)
    assert np.abs(same.nodes - draped.nodes).max() < 1e-4
    loose = replace(draped, rest=draped.rest._replace(held=np.zeros(0, dtype=np.int64)))
    assert hold_as_target(loose, matches, there, skin, cloth) is loose
    assert hold_as_target(draped, [], there, skin, cloth) is draped
    # A garment whose belt was laid lower is what its pattern gives, sewn anew and hung there.
    fitted = SimpleNamespace(pattern=draped.mesh.pattern, cloth=cloth, nodes=found.nodes)
    search, shown = SimpleNamespace(forward=None), Shown(found.mesh, found.nodes)
    report = cast(Recovered, SimpleNamespace(fitted=fitted, search=search, sewn=None, shown=shown))
    anew = sew_anew(report, starts.DrapeStart(body, SewingOptions(edge_length_m=0.1, grid_m=0.02), None, None))
    assert anew.distance.rms_mm < min(3.0, 0.8 * anew.by_itself.rms_mm)
    assert_allclose(anew.belt_moved_m, (found.nodes - draped.nodes)[held, 1].mean(), atol=1e-3)
