"""Poses through all stages, and the bound that every frame must keep."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from drape.stages.batch import Batch, PoseInput
from drape.stages.walk import run
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime

GARMENT_REACH_M = 1.0  # beyond the body's own box: no garment of the tests is longer
FOLDS = 1


def draped(
    runtime: DrapeRuntime,
    poses: np.ndarray,
    *,
    trans: np.ndarray | None = None,
    betas: np.ndarray | None = None,
    times_s: np.ndarray | None = None,
    memories: Mapping[Any, Any] | None = None,
    **options: Any,
) -> Batch:
    """``poses`` (F, 24, 3) [rad] through all stages, folds and push-out included, as messages."""
    asked = DrapeOptions(**{"push_out": True, "folds": FOLDS, "settle": 2} | options)
    plan = runtime.plan(runtime.garments.get("tube"), asked, messages=True)
    for stage in plan.stages:
        stage.prepare(plan)
    frames = len(poses)
    trans = np.zeros((frames, 3)) if trans is None else trans
    times_s = np.arange(frames) / 30.0 if times_s is None else times_s
    return run(plan, [PoseInput(poses, trans, np.zeros(10) if betas is None else betas, times_s, memories or {})])


def check_bounded(runtime: DrapeRuntime, batch: Batch) -> None:
    """The vertices are finite and within the posed body's box and a garment's reach, and the roots are the body's."""
    (one,) = batch.inputs
    relative = runtime.body.posed_vertices(one.poses, np.zeros_like(one.trans), one.betas)
    relative -= runtime.body.rest_joints(one.betas)[0]
    assert np.isfinite(batch.vertices).all() and np.isfinite(batch.root).all()
    assert (batch.vertices.max(axis=1) <= relative.max(axis=1) + GARMENT_REACH_M).all()
    assert (batch.vertices.min(axis=1) >= relative.min(axis=1) - GARMENT_REACH_M).all()
    np.testing.assert_allclose(batch.root, one.trans + runtime.body.rest_joints(one.betas)[0], rtol=0.0, atol=1e-9)
