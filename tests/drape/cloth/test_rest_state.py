"""Rest states: what a mesh remembers, in the axes of its fabric."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.cloth import energies, rest_state
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric, bending_angle, hinge_rigidity
from drape.cloth.material import Material
from drape.errors import InputError, MeshError
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import grid, random_rotation, tube

FABRIC = Fabric("woven", 900.0, 400.0, 55.0, 120.0, 2.0e-5, 1.1e-5, 1.3e-5, 0.15)
WOVEN = Material.of(FABRIC)
LOOSE = replace(WOVEN, bending_j=0.0, bending_2_j=0.0, bending_4_j=0.0)


def panel(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """An uneven sheet in the x-y plane: x the weft, y the warp."""
    rest, faces = grid(6, 5)
    rest[:, :2] += 0.001 * rng.normal(size=(len(rest), 2))
    return rest, faces


def test_hinges_bend_by_their_direction_to_the_warp(rng):
    rest, faces = panel(rng)
    moved = rest + np.stack([0.0 * rest[:, 0], 0.0 * rest[:, 0], 20.0 * rest[:, 0] * rest[:, 1]], axis=1)
    mesh, hinges = ClothMesh.from_rest(rest, faces), meshes.hinges(faces)
    rigidity = hinge_rigidity(FABRIC, bending_angle((rest[hinges[:, 1]] - rest[hinges[:, 0]])[:, :2]))
    angle = rest_state.dihedral_angles(moved, faces)
    expected = (rigidity * mesh.hinge_weight * (1.0 - np.cos(angle))).sum()
    assert_allclose(energies.bending(moved, mesh, WOVEN), expected, rtol=1e-4, atol=0.0)  # the guard of the angle


def test_grain_turns_with_the_garment_and_changes_no_energy(rng):
    rest, faces = panel(rng)
    moved, turn = rest + 0.003 * rng.normal(size=rest.shape), random_rotation(rng)
    grain = np.broadcast_to([0.6, 0.8, 0.0], (len(faces), 3))
    one = ClothMesh.of(rest_state.modelled_rest(rest, faces, grain), faces, len(rest))
    other = ClothMesh.of(rest_state.modelled_rest(rest @ turn.T, faces, grain @ turn.T), faces, len(rest))
    for part in (energies.membrane, energies.bending):
        assert_allclose(part(moved @ turn.T, other, WOVEN), part(moved, one, WOVEN), rtol=1e-10, atol=0.0)
    warp_only = replace(LOOSE, weft_n_per_m=1e-9, cross_n_per_m=0.0, shear_n_per_m=1e-9)
    pulled = rest + 0.1 * (rest @ [-0.8, 0.6, 0.0])[:, None] * np.array([-0.8, 0.6, 0.0])
    assert energies.membrane(pulled, one, warp_only) < 1e-9 * energies.membrane(pulled, one, WOVEN)


def test_many_cloths_at_once_are_each_on_its_own(rng):
    rest, faces = panel(rng)
    moved = torch.tensor(rest + 0.002 * rng.normal(size=(3, *rest.shape)))
    mesh = ClothMesh.from_rest(rest, faces).like(moved)
    each = [WOVEN, WOVEN.scaled(2.0), LOOSE]
    numbers = torch.tensor([[*m.membrane, *m.bending, m.density_kg_m2] for m in each], dtype=torch.float64)
    warp, weft, cross, shear, b, b2, b4, density = numbers.T[..., None]
    stacked = Material(warp, weft, cross, shear, b, b2, b4, density)
    for part in (energies.membrane, energies.bending, energies.gravity):
        together = part(moved, mesh, stacked)
        for at, own in enumerate(each):
            assert_allclose(together[at].numpy(), part(moved[at], mesh, own).numpy(), rtol=1e-12, atol=1e-18)


def test_a_flat_rest_forgets_angles_and_keeps_lengths():
    rest, faces = tube()
    shaped, level = rest_state.modelled_rest(rest, faces), rest_state.flat_rest(rest, faces)
    assert np.abs(shaped.hinge_angle).max() > 0.1 and not level.hinge_angle.any()
    mesh = ClothMesh.of(level, faces, len(rest))
    assert energies.membrane(rest, mesh, WOVEN) < 1e-20 < 1e-7 < energies.bending(rest, mesh, WOVEN)


def test_a_stiffened_hinge_counts_as_often(rng):
    rest, faces = panel(rng)
    moved = rest + 0.002 * rng.normal(size=rest.shape)
    state = rest_state.flat_rest(rest, faces)
    doubled = replace(state, stiffening=2.0 * state.stiffening)
    once, twice = (energies.bending(moved, ClothMesh.of(s, faces, len(rest)), WOVEN) for s in (state, doubled))
    assert_allclose(twice, 2.0 * once, rtol=1e-12, atol=0.0)


def test_warp_hangs_vertically_and_runs_forward_where_cloth_lies_level():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    upright, level = rest_state.grain_along(vertices, np.array([[0, 1, 2], [0, 3, 1]]))
    assert_allclose(upright, [0.0, 1.0, 0.0], rtol=0.0, atol=1e-15)
    assert_allclose(level, [0.0, 0.0, 1.0], rtol=0.0, atol=1e-15)


def test_unphysical_rest_states_are_refused():
    rest, faces = grid(3, 3)
    state = rest_state.flat_rest(rest, faces)
    with pytest.raises(MeshError, match="area zero"):
        replace(state, edges=state.edges * np.array([1.0, 0.0])[None, :, None])
    with pytest.raises(MeshError, match="hinge angles"):
        replace(state, hinge_angle=np.full_like(state.hinge_angle, np.nan))
    with pytest.raises(InputError, match="stiffening"):
        replace(state, stiffening=-state.stiffening)
