"""Cloth laid on its target by springs, and let go: closed forms on flat sheets and balls."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.testing import assert_allclose

from recovery.drape.pattern_drape import HANGS_LONGER, Draped, SewingOptions
from recovery.drape.settle import SettledDrape
from recovery.fit import laying
from recovery.fit.laying import (
    LaidDrape,
    Shown,
    hung_as,
    in_other_folds,
    is_laid,
    laying_options,
    let_fall,
    put_on,
    springs_between,
)
from recovery.fit.objective import TargetSurface
from recovery.pattern.bases import base_pattern
from recovery.pattern.pattern_mesh import PatternMesh, mesh_pattern
from recovery.pattern.sewing_pattern import Pattern
from recovery.sim.newton_steps import Report
from recovery.sim.skin_contact import PlaneDistance, Sphere
from tests.recovery.pattern_setup import default_measurements, rectangle
from tests.recovery.sim_setup import WOVEN

NOWHERE = Sphere((0.0, -10.0, 0.0), 0.1)


def sheet(height_m: float = 0.0) -> tuple[PatternMesh, np.ndarray]:
    """A square of 30 cm that lies at this height, and its nodes."""
    mesh = mesh_pattern(Pattern("sheet", (rectangle("sheet", 0.3, 0.3),), ()), 0.05)
    flat = mesh.nodes_from(mesh.placed())
    return mesh, np.stack([flat[:, 0], np.full(len(flat), height_m), flat[:, 1]], axis=1)


def target_of(mesh: PatternMesh, nodes: np.ndarray) -> TargetSurface:
    return TargetSurface.from_mesh(nodes, mesh.faces)


def test_springs_draw_both_surfaces_together_by_their_area():
    """A sheet 2 cm above another: twice stiffness times area times gap, straight down; none where nothing is known."""
    mesh, low = sheet()
    high = low + np.array([0.0, 0.02, 0.0])
    found = springs_between(high, mesh.faces, target_of(mesh, low), 300.0)
    pull = (1.0 + laying.ACROSS) * 300.0 * 0.02 * 0.09
    assert_allclose(found.force.sum(dim=0), [0.0, -2.0 * pull, 0.0], atol=1e-9)
    up = np.tile([0.0, 1.0, 0.0], len(high))
    assert_allclose(up @ (found.stiffness @ up), 2.0 * pull / 0.02)
    along = np.tile([1.0, 0.0, 0.0], len(high))
    assert_allclose(along @ (found.stiffness @ along), laying.ACROSS * 2.0 * 300.0 * 0.09)
    unknown = springs_between(high, mesh.faces, replace(target_of(mesh, low), known=np.zeros(len(mesh.faces))), 300.0)
    assert float(unknown.force.abs().max()) == 0.0


def test_a_sheet_is_laid_on_a_wave():
    """Cloth as large as the target ends on it, within what its weight is over the springs'."""
    mesh, flat = sheet()
    wave = flat + np.stack([0 * flat[:, 0], 0.015 * np.sin(20.0 * flat[:, 0]), 0 * flat[:, 0]], axis=1)
    forward = LaidDrape(mesh, NOWHERE, WOVEN, target_of(mesh, wave))
    before, after = (np.abs(x[:, 1] - wave[:, 1]).mean() for x in (flat, forward.begun(flat)))
    assert before > 0.008 and after < 0.0035


def test_the_laid_drape_moves_as_its_sensitivity_says():
    """Against differences of drapes that go on until they stand still, pulled by a target that is larger."""
    mesh, flat = sheet()
    forward = LaidDrape(mesh, NOWHERE, WOVEN, target_of(mesh, 1.05 * flat))
    nodes = flat
    for _ in range(3):
        nodes = forward.begun(nodes)
    rng = np.random.default_rng(3)
    way = mesh.rest_at(rng.normal(size=mesh.controls.positions.shape))
    found = forward.sensitivity(torch.from_numpy(mesh.rest), nodes, way[:, :, None])[:, :, 0]
    step = 1e-4
    ends = []
    for sign in (1.0, -1.0):
        rest = torch.from_numpy(mesh.rest + sign * step * way)
        x = nodes
        for _ in range(8):
            x = forward(rest, x)[0].numpy()
        ends.append(x)
    numeric = (ends[0] - ends[1]) / (2.0 * step)
    share = (found * numeric).sum() / np.sqrt((found**2).sum() * (numeric**2).sum())
    assert share > 0.95


def test_what_is_let_go_stays_on_a_slope_that_friction_holds():
    mesh, flat = sheet()
    slope = np.array([0.2, 1.0, 0.0]) / np.hypot(0.2, 1.0)  # less than friction holds
    across = np.stack([[slope[1], -slope[0], 0.0], slope, [0.0, 0.0, 1.0]])
    start = flat @ across + 0.0035 * slope
    drape = let_fall(mesh, start, PlaneDistance((0.0, 0.0, 0.0), tuple(slope)), WOVEN)
    assert drape.report.converged and drape.steps < laying.FREE_STEPS and not len(drape.held)
    assert np.abs(drape.nodes - start).max() < 0.002


def test_gathers_are_told_by_the_lengths_of_seams_and_belts_by_the_openings():
    body = default_measurements()
    dress = base_pattern("sleeved_dress", body, ("gather=0.25",))
    assert is_laid(dress, ("trunk", None, "left_arm"))
    assert not is_laid(dress, ("trunk", None))
    assert not is_laid(base_pattern("tshirt", body), ("trunk", "left_arm"))


def test_options_for_cloth_that_is_laid():
    found = laying_options(SewingOptions(edge_length_m=0.05))
    assert found.edge_length_m == laying.EDGE_M and found.iteration_limit == 0 and found.hangs_longer < HANGS_LONGER
    assert laying_options(SewingOptions(edge_length_m=0.02)).edge_length_m == 0.02


def test_a_drape_in_other_folds_is_hung_in_those_of_another_mesh():
    """A sheet on a slope that friction holds, 8 cm down it: it goes back to where a finer mesh lies."""
    mesh, flat = sheet()
    slope = np.array([0.2, 1.0, 0.0]) / np.hypot(0.2, 1.0)
    across = np.stack([[slope[1], -slope[0], 0.0], slope, [0.0, 0.0, 1.0]])
    fine = mesh_pattern(mesh.pattern, 0.03)
    lies = np.stack([fine.nodes_from(fine.placed())[:, k] for k in (0, 2, 1)], axis=1)
    shown = Shown(fine, lies @ across + 0.0035 * slope)
    skin = PlaneDistance((0.0, 0.0, 0.0), tuple(slope))
    there = flat @ across + 0.0035 * slope + 0.08 * across[0]
    unused: Any = None
    loose = Draped(
        mesh, unused, unused, SettledDrape(there, np.zeros(0, dtype=np.int64), Report(0, 0.0, True), 0), None, {}
    )
    assert in_other_folds(loose, shown)
    hung = hung_as(loose, shown, skin, WOVEN)
    assert hung.at_rest and not in_other_folds(hung, shown)
    belted = replace(loose, rest=loose.rest._replace(held=np.array([0])))
    assert not in_other_folds(belted, shown)
    assert put_on(belted, shown, lambda one: one) is belted, "its belt could not be laid"
    placed = put_on(belted, shown, lambda one: replace(one, figures={"laid": 1.0}))
    assert placed.figures and not in_other_folds(replace(placed, rest=loose.rest._replace(nodes=placed.nodes)), shown)
