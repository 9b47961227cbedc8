"""Garments of few and many vertices, tiny and huge, with slivers and doubled vertices; charts without a plane."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from drape.body.assets import load_body
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.contact.samples import sample_table
from drape.errors import MeshError
from drape.garment.avatars import standard_avatar
from drape.garment.consensus import RIDGE, _weighted_fit
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.garment.mesh_checks import check_mesh, check_surface, place_on_avatar
from drape.geometry import jets
from drape.live.fold_constants import FoldConstants, WornCloth
from drape.live.fold_step import FoldEffort, Frame, fold
from drape.live.skin_walks import nearest_at_rest, skin_graph
from tests.drape.cloth.cloth_shapes import tube
from tests.drape.garment.garment_files import shirt
from tests.drape.live.folds_setup import FAR_M, arm

BODY = load_body()
CONDITION_LIMIT = 2e5  # of the normal matrix of a chart's fit, its ridge included


def folded(rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The tube ``rest`` [m] (V, 3), a little rough, over an arm, after three frames of folds."""
    skin = arm()
    cloth = ClothMesh.from_rest(rest, faces)
    dressed = WornCloth(cloth, Material(), np.full(len(rest), 1.0), skin_graph(skin), nearest_at_rest(rest, skin))
    constants, memory, table = FoldConstants.of(dressed), None, np.asarray(sample_table(skin.point, skin.normal))
    rough = rest * (1.0 + 0.01 * np.random.default_rng(0).normal(size=rest.shape))
    for number in range(3):
        x, memory, _ = fold(constants, memory, Frame(rough, table, number / 30.0), FoldEffort(steps=1, settle=1))
    assert np.isfinite(x).all() and np.linalg.norm(x - rough, axis=1).max() <= FAR_M
    return x


@pytest.mark.parametrize(("around", "along"), [(10, 4), (200, 99)])
def test_folds_of_few_and_of_many_vertices(around: int, along: int):
    """Guards against blocks that are not full, and against sizes that only a small mesh has; 50 and 20,000 vertices."""
    rest, faces = tube(around, along, radius_m=0.06, height_m=0.2)
    assert len(rest) == around * (along + 1)
    folded(rest, faces)


@pytest.mark.parametrize("size_m", [0.001, 10.0])
def test_folds_of_a_garment_of_a_millimetre_and_of_ten_metres(size_m: float):
    """Guards against numbers that suit one size only: areas span eight orders of magnitude."""
    rest, faces = tube(10, 6, radius_m=size_m / 2.0, height_m=size_m)
    folded(rest, faces)


def test_folds_of_slivers():
    """Guards against the inverse of a rest edge matrix that is nearly singular: rows a thousandth of the others."""
    rest, faces = tube(10, 6, radius_m=0.06, height_m=0.12)
    rest[10:20, 1] = rest[:10, 1] + 2e-5
    folded(rest, faces)


CLOTH = plain_mesh("shirt", *shirt(BODY, BODY.v_template))


def checked(vertices: np.ndarray) -> GarmentMesh:
    surface = check_surface(plain_mesh("shirt", vertices, CLOTH.faces))
    return check_mesh(place_on_avatar(surface, standard_avatar(BODY), unit="m"), standard_avatar(BODY))


@pytest.mark.parametrize("factor", [1e-3, 10.0, 1e-30, 1e30])
def test_garments_of_a_millimetre_and_of_ten_metres_are_refused_with_a_cure(factor: float):
    """Guards against a wrong unit that is draped as it came."""
    with pytest.raises(MeshError) as refused:
        checked(factor * CLOTH.vertices)
    assert refused.value.cure


def test_slivers_and_doubled_vertices_are_left_out_of_the_cloth():
    """Guards against a triangle without a normal, and against vertices that are one and are taken for two."""
    a, b, c = CLOTH.faces[0]
    for moved, place in ((c, CLOTH.vertices[[a, b]].mean(axis=0)), (b, CLOTH.vertices[a])):
        vertices = CLOTH.vertices.copy()
        vertices[moved] = place
        cloth = checked(vertices)
        assert 0 < len(CLOTH.faces) - len(cloth.faces) <= 2
        assert any(note.startswith("dropped") for note in cloth.notes)


@pytest.mark.parametrize("points", ["line", "point", "one", "two", "plane"])
def test_the_fit_of_a_chart_without_a_plane_is_bounded(points: str, record_property: Callable[[str, object], None]):
    """Guards against coefficients that grow without bound where collinear points do not determine them.

    The ridge bounds the condition of the normal matrix, and so what a value can do to a coefficient.
    """
    t = np.linspace(-1.0, 1.0, 40)
    uv = {
        "line": np.stack([t, 0.5 * t], axis=1), "point": np.zeros((40, 2)), "one": np.zeros((1, 2)),
        "two": np.array([[0.1, 0.0], [0.1 + 1e-7, 0.0]]),
        "plane": np.random.default_rng(0).uniform(-1.0, 1.0, (40, 2)),
    }[points]  # fmt: skip
    basis = jets.basis(uv, jets.HEIGHT_ORDER)
    fit = _weighted_fit(basis, np.full(len(uv), 1.0 / len(uv)))
    assert np.isfinite(fit).all()
    singular = np.linalg.svd(fit @ basis, compute_uv=False)
    assert singular.max() <= 1.0 + 1e-9, "a fit of a fit must not grow"
    mean = float((basis**2).sum() / len(uv) / basis.shape[1])  # of the normal matrix's diagonal
    condition = (basis.shape[1] * mean + RIDGE * mean) / (RIDGE * mean)  # at most: all of the trace in one direction
    record_property("condition", condition)
    assert condition <= CONDITION_LIMIT
    assert np.linalg.norm(fit, 2) <= 0.5 / np.sqrt(RIDGE * mean * len(uv)) + 1e-9
