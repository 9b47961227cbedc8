"""Mantles in frames of the service: laid by their arms in place of the network."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from drape.garment.cache import Garment, load_garment, save_garment
from drape.garment.mantle_shapes import DIRECTIONS, worn
from drape.stages.batch import PoseInput
from drape.stages.walk import run
from drape.wire.options import Advanced, DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from tests.fixtures.poses import smooth_motion

TIMES_S = np.arange(3) / 30.0
POSES, TRANS = smooth_motion(TIMES_S)
CLIP = PoseInput(POSES, TRANS, np.linspace(-1.0, 1.0, 10), TIMES_S)
LAID = DrapeOptions(advanced=Advanced(folds=0, push_out=False), motion=0.0)


def mantle(tube: Garment) -> Garment:
    """The tube as if half of it went with arms, and hung lower the farther they are from the T-pose."""
    count = len(tube.vertices)
    ways = np.zeros((count, len(DIRECTIONS), 3), np.float32)
    ways[:, :, 1] = -0.1 * np.linalg.norm(DIRECTIONS - [1.0, 0.0, 0.0], axis=1)
    return replace(tube, digest="d" * 64, arm_share=np.full(count, 0.5, np.float32), arm_ways=ways)


def test_a_mantle_is_laid_by_its_arms_and_other_cloth_by_the_network(
    make_runtime: Callable[..., DrapeRuntime], tube: Garment
):
    runtime, garment = make_runtime(), mantle(tube)
    plans = [runtime.plan(runtime.garments.add(one, "user"), LAID, messages=False) for one in (garment, tube)]
    assert [[stage.name for stage in plan.stages].count("mantles") for plan in plans] == [1, 0]
    runtime.ready(plans[0])
    found = run(plans[0], [CLIP]).vertices
    assert garment.arm_ways is not None
    binding = garment.binding(runtime.body)
    rest = garment.vertices.astype(np.float64)
    wanted = worn(rest, garment.arm_ways, binding, runtime.body, POSES, CLIP.betas)[:, : garment.vertex_count]
    assert_allclose(found, wanted, rtol=0, atol=1e-6)


def test_a_mantle_comes_back_from_its_file(tmp_path: Path, tube: Garment):
    garment = mantle(tube)
    back = load_garment(save_garment(garment, tmp_path))
    assert_array_equal(back.arm_ways, garment.arm_ways)
    assert_array_equal(back.arm_share, garment.arm_share)
