"""A mesh that hangs on cloth: the engine against the formulas, and what bends, turns and keeps its shape."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from drape.garment.bound import OFF, ON, STIFF, BoundMesh, Drawer, bind, frames
from drape.garment.files.mesh import plain_mesh
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import tube

CLOTH, FACES = tube(24, 12, radius_m=0.25, height_m=0.5)
RNG = np.random.default_rng(5)


def hung(count: int = 60) -> tuple[BoundMesh, np.ndarray]:
    """A mesh of ``count`` vertices on the cloth, off it and stiff, and where they are."""
    face = RNG.integers(len(FACES), size=count)
    share = RNG.dirichlet(np.ones(3), size=count)
    normals = meshes.vertex_normals(CLOTH, FACES)[FACES[face]]
    places = np.einsum("nk,nkc->nc", share, CLOTH[FACES[face]] + 0.01 * normals)
    row, part = np.full(count, -1), np.full(count, -1)
    row[: count // 3] = RNG.permutation(len(CLOTH))[: count // 3]
    places[: count // 3] = CLOTH[row[: count // 3]]
    part[2 * count // 3 :] = np.arange(count - 2 * count // 3) // 4
    mesh = plain_mesh("button", places, np.arange(count).reshape(-1, 3))
    return bind(mesh, places, CLOTH, FACES, row, part), places


def reference(bound: BoundMesh, cloth: np.ndarray) -> np.ndarray:
    """The formulas of ``drape.garment.bound``, one vertex after the other."""
    normals = meshes.vertex_normals(cloth, FACES)
    drawn = []
    for corner, weight, offset, kind in zip(bound.corner, bound.weight, bound.offset, bound.kind, strict=True):
        place = weight.astype(float) @ cloth[corner]
        if kind == OFF:
            place = place + offset[2] * (weight.astype(float) @ normals[corner])
        elif kind == STIFF:
            place = place + offset.astype(float) @ frames(cloth[corner][None])[0]
        drawn.append(place)
    return np.array(drawn)


@pytest.mark.parametrize(("dtype", "within_m"), [(np.float64, 1e-12), (np.float32, 2e-6)])
def test_engine_has_the_formulas(dtype: type, within_m: float):
    bound, places = hung()
    assert {ON, OFF, STIFF} == set(bound.kind.tolist())
    bent = CLOTH + 0.1 * np.sin(3.0 * CLOTH[:, [1, 2, 0]])
    for cloth in (CLOTH, bent):
        drawn = Drawer(bound, FACES).draw(cloth.astype(dtype))
        assert drawn.dtype == dtype
        assert_allclose(drawn, reference(bound, cloth), rtol=0, atol=within_m)
    assert_allclose(reference(bound, CLOTH), places, rtol=0, atol=6e-4)  # SLACK_M


def test_what_hangs_turns_with_the_cloth():
    bound, _ = hung()
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    drawn = Drawer(bound, FACES).draw(CLOTH @ turn.T + [1.0, 2.0, 3.0])
    assert_allclose(drawn, Drawer(bound, FACES).draw(CLOTH) @ turn.T + [1.0, 2.0, 3.0], rtol=0, atol=1e-6)


def test_stiff_parts_keep_their_shape_where_cloth_is_stretched():
    bound, _ = hung()
    stretched = CLOTH * [1.3, 0.8, 1.1]
    stiff = slice(-20, None)  # five parts of four vertices
    before, after = (Drawer(bound, FACES).draw(cloth)[stiff].reshape(-1, 4, 3) for cloth in (CLOTH, stretched))

    def gaps(points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)

    assert_allclose(gaps(after), gaps(before), rtol=0, atol=1e-9)
    assert gaps(before).max() > 0.01
