"""What hangs on cloth and what bones carry, in frames of the service."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.skeleton import JOINT_NAMES
from drape.garment.bound import bind
from drape.garment.cache import Garment
from drape.garment.files.mesh import plain_mesh
from drape.geometry import meshes
from drape.stages.batch import Batch, PoseInput
from drape.stages.walk import run
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from tests.fixtures.poses import smooth_motion

TIMES_S = np.arange(3) / 30.0
POSES, TRANS = smooth_motion(TIMES_S)
CLIP = PoseInput(POSES, TRANS, np.linspace(-1.0, 1.0, 10), TIMES_S)


def draped(runtime: DrapeRuntime, garment: Garment, **options: object) -> Batch:
    entry = runtime.garments.add(garment, "user")
    plan = runtime.plan(entry, DrapeOptions.model_validate({"folds": 0, "push_out": False, **options}), messages=False)
    runtime.ready(plan)
    return run(plan, [CLIP])


def buttoned(garment: Garment, digest: str) -> Garment:
    """``garment`` with a second layer 4 mm over all of it."""
    cloth, faces = garment.vertices[: garment.vertex_count].astype(float), garment.faces.astype(np.int64)
    over = cloth + 0.004 * meshes.vertex_normals(cloth, faces)
    places, row = np.concatenate([cloth, over]), np.append(np.arange(len(cloth)), np.full(len(over), -1))
    mesh = plain_mesh("tube", places, np.concatenate([faces, faces + len(cloth)]))
    drawn = bind(mesh, places, cloth, faces, row, np.full(len(row), -1))
    return replace(garment, digest=digest, drawn=drawn)


def test_a_drawn_mesh_comes_and_its_cloth_where_that_is_asked_for(
    make_runtime: Callable[..., DrapeRuntime], tube: Garment
):
    runtime = make_runtime()
    plain = draped(runtime, replace(tube, digest="a" * 64)).vertices
    garment = buttoned(tube, "b" * 64)
    found = draped(runtime, garment).vertices
    count = tube.vertex_count
    assert found.shape == (3, 2 * count, 3)
    assert_array_equal(found[:, :count], plain)
    assert_array_equal(found, garment.drawn_vertices(plain))
    gaps = np.linalg.norm(found[:, count:] - found[:, :count], axis=2)
    assert_allclose(gaps, 0.004, rtol=0, atol=1e-3)
    fine = draped(runtime, replace(garment, digest="c" * 64), resolution="fine").vertices
    assert fine.shape[1] == len(tube.vertices)


def test_what_a_bone_carries_moves_with_it_and_keeps_its_shape(
    make_runtime: Callable[..., DrapeRuntime], tube: Garment
):
    runtime = make_runtime()
    carried = replace(tube, digest="d" * 64, manifest=tube.manifest | {"carried_by": ["head"]})
    batch = draped(runtime, carried)
    rotations, translations = runtime.body.bones(POSES, TRANS, CLIP.betas)
    head = JOINT_NAMES.index("head")
    shifted = (
        tube.vertices[: tube.vertex_count] + (runtime.body.rest_joints(CLIP.betas) - runtime.body.joints_template)[head]
    )
    wanted = np.einsum("fab,vb->fva", rotations[:, head], shifted) + translations[:, None, head]
    assert_allclose(batch.world(), wanted, rtol=0, atol=1e-5)
