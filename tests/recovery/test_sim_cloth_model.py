"""The sewn mesh: static assembly, invariances of its forces, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from torch import Tensor

from drape.cloth import bending, energies, membrane
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.cloth.material import Material, OrthotropicMaterial, material
from drape.cloth.rest_state import dihedral_angles, flat_rest
from drape.errors import InputError, MeshError
from recovery.sim.cloth_model import (
    ClothModel,
    Parameters,
    elastic_bilinear,
    elastic_energy,
    elastic_forces,
    elastic_hessian,
    elastic_work,
    superlu,
)
from tests.recovery.sim_setup import WOVEN, crumpled, crumpled_tube, lifted, sewn_tube, strip

ISOTROPIC = material("jersey").woven
WARPED = Fabric("woven", 9.0, 4.0, 0.55, 1.2, 2.0e-5, 1.1e-5, 1.3e-5, 0.15)


def test_assembly_by_static_maps_equals_a_loop_over_elements():
    model, _, parameters, rest, x = crumpled_tube()
    stretched = membrane.membrane_hessian(model.triangles(x), rest.triangles, parameters.membrane, definite=False)
    stiffness = rest.hinge_weight * parameters.bending_j
    bent = bending.bending_hessian(model.hinges(x), stiffness, model.rest_angle, definite=False)
    expected = np.zeros((model.node_count * 3,) * 2)
    for nodes_of, stack in ((model.faces.T, stretched.numpy()), (model.hinge_nodes.T, bent.numpy())):
        for element in range(nodes_of.shape[1]):
            unknowns = (3 * nodes_of[:, element, None] + np.arange(3)).reshape(-1)
            expected[np.ix_(unknowns, unknowns)] += stack[:, :, element]
    found = elastic_hessian(model, rest, parameters, x, definite=False).toarray()
    assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    assert_allclose(found, found.T, rtol=0, atol=1e-12 * np.abs(expected).max())


def check_derivatives(model: ClothModel, parameters: Parameters, x: Tensor) -> None:
    """Forces, Hessians and contractions at ``x`` against derivatives of the energy."""
    rest, leaf = model.rest(parameters.panels), x.clone().requires_grad_(True)
    (slope,) = torch.autograd.grad(elastic_energy(model, rest, parameters, leaf), leaf)
    assert_allclose(elastic_forces(model, rest, parameters, x), -slope, rtol=0, atol=1e-11 * float(slope.abs().max()))
    direction = torch.from_numpy(np.random.default_rng(4).normal(size=x.shape))
    flattened, step = direction.numpy().reshape(-1), 1e-7
    assert_allclose(elastic_work(model, rest, parameters, x, direction), float((slope * direction).sum()), rtol=1e-9)
    ahead, behind = (elastic_forces(model, rest, parameters, x + sign * step * direction) for sign in (1.0, -1.0))
    product = elastic_hessian(model, rest, parameters, x, definite=False) @ flattened
    change = (behind - ahead).numpy().reshape(-1) / (2 * step)
    assert_allclose(change, product, rtol=0, atol=1e-6 * np.abs(product).max())
    matrix = elastic_hessian(model, rest, parameters, x, definite=True)
    pair = elastic_bilinear(model, rest, parameters, x, direction, direction)
    assert_allclose(pair, flattened @ (matrix @ flattened), rtol=1e-9)


def test_assembled_forces_and_hessian_are_derivatives_of_the_energy():
    model, _, parameters, _, x = crumpled_tube()
    check_derivatives(model, parameters, x)


def test_the_definite_system_is_definite_for_crumpled_cloth():
    model, panels, nodes = sewn_tube()
    parameters = model.parameters(panels, WOVEN)
    rest = model.rest(parameters.panels)
    for seed in range(20):
        x = crumpled(model, 0.5 * nodes, size_m=0.01, seed=seed).x
        values = np.linalg.eigvalsh(elastic_hessian(model, rest, parameters, x, definite=True).toarray())
        assert values[0] > -1e-12 * values[-1]
        exact = np.linalg.eigvalsh(elastic_hessian(model, rest, parameters, x, definite=False).toarray())
        assert exact[0] < -1.0


def test_a_garment_modelled_in_space_is_at_rest_in_its_own_shape_and_its_forces_are_derivatives():
    _, panels, nodes = sewn_tube()
    shaped = nodes + np.random.default_rng(2).normal(size=nodes.shape) * 0.004
    model, _, _ = sewn_tube()
    model.rest_angle = torch.from_numpy(dihedral_angles(shaped, model.faces))
    limp = model.parameters(panels, WOVEN)._replace(stretch=torch.zeros(4, dtype=torch.float64))
    rest = model.rest(limp.panels)
    flat_model, _, _ = sewn_tube()
    assert float(elastic_forces(flat_model, rest, limp, torch.from_numpy(shaped)).abs().max()) > 1e-4
    assert_allclose(elastic_forces(model, rest, limp, torch.from_numpy(shaped)), 0.0, rtol=0, atol=1e-14)
    for parameters in (limp, model.parameters(panels, WOVEN)):
        check_derivatives(model, parameters, crumpled(model, nodes).x)


def test_the_simulator_has_the_energy_of_the_network(rng):
    """x of a panel is the weft, y the warp."""
    panel, faces = strip(4, 3, length_m=0.2, width_m=0.15)
    flat_nodes = lifted(panel)
    cloth = replace(Material.of(WARPED), bending_2_j=0.0, bending_4_j=0.0)  # the simulator's bends alike all around
    grain = np.broadcast_to([0.0, 0.0, -1.0], (len(faces), 3))
    mesh, model = ClothMesh.of(flat_rest(flat_nodes, faces, grain), faces, len(panel)), ClothModel(faces)
    x = flat_nodes + 4e-3 * rng.normal(size=flat_nodes.shape)
    parameters = model.parameters(panel, cloth.woven)
    found = elastic_energy(model, model.rest(parameters.panels), parameters, torch.from_numpy(x))
    expected = energies.membrane(x, mesh, cloth) + energies.bending(x, mesh, cloth)
    assert_allclose(found, expected, rtol=1e-8)


def test_rest_has_no_force_and_any_shape_no_net_force_or_torque():
    panel, faces = strip(5, 4, length_m=0.2, width_m=0.1)
    flat = ClothModel(faces)
    parameters = flat.parameters(panel, WOVEN)
    force = elastic_forces(flat, flat.rest(parameters.panels), parameters, flat.state(lifted(panel)).x)
    assert_allclose(force, 0.0, rtol=0, atol=1e-12)
    model, _, parameters, rest, x = crumpled_tube()
    force = elastic_forces(model, rest, parameters, x)
    scale = float(force.abs().max())
    assert_allclose(force.sum(dim=0), 0.0, rtol=0, atol=1e-12 * scale)
    assert_allclose(torch.linalg.cross(x, force).sum(dim=0), 0.0, rtol=0, atol=1e-12 * scale)


def test_rigid_motion_of_the_garment_changes_no_energy(rng):
    model, _, parameters, rest, x = crumpled_tube()
    turn = Rotation.random(rng=rng).as_matrix()
    moved = torch.from_numpy(x.numpy() @ turn.T + rng.normal(size=3))
    before, after = (elastic_energy(model, rest, parameters, at) for at in (x, moved))
    assert_allclose(after, before, rtol=1e-10)
    expected = elastic_forces(model, rest, parameters, x).numpy() @ turn.T
    found = elastic_forces(model, rest, parameters, moved)
    assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_the_pattern_gradient_ignores_rigid_motions_of_a_panel():
    """Moving a panel changes nothing; turning it turns the grain, which only a woven cloth feels."""
    model, panels, _, _, x = crumpled_tube()
    front = np.arange(len(panels)) < len(panels) // 2
    for cloth, feels_turn in ((ISOTROPIC, False), (WOVEN, True)):
        parameters = model.parameters(panels, cloth)
        leaf = parameters.panels.requires_grad_(True)
        (slope,) = torch.autograd.grad(elastic_energy(model, model.rest(leaf), parameters, x), leaf)
        own = slope.numpy()[front]
        scale = np.abs(own).max()
        assert_allclose(own.sum(axis=0), 0.0, rtol=0, atol=1e-11 * scale)
        torque = (panels[front] * own[:, ::-1] * [1.0, -1.0]).sum()
        assert (abs(torque) > 1e-4 * scale) == feels_turn
        assert feels_turn or abs(torque) < 1e-12 * scale


def test_nodes_have_the_area_of_the_pattern_and_one_panel_vertex_or_two():
    model, panels, nodes = sewn_tube()
    assert_allclose(model.rest(torch.from_numpy(panels)).node_area.sum(), 2 * 0.2 * 0.15, rtol=1e-12)
    count = np.bincount(model.node_of_panel_vertex)
    assert len(count) == len(nodes) and count.sum() == len(panels)
    assert set(count.tolist()) == {1, 2}


def test_the_pivots_count_the_negative_eigenvalues():
    model, panels, nodes = sewn_tube(fixed=[0, 1, 2])
    parameters = model.parameters(panels, WOVEN)
    rest = model.rest(parameters.panels)
    counts = []
    for seed in range(5):
        x = crumpled(model, nodes * (1.0 - 0.1 * seed), size_m=0.005, seed=seed).x
        matrix = elastic_hessian(model, rest, parameters, x, definite=False)
        counts.append(superlu(matrix).negative_pivots())
        assert counts[-1] == (np.linalg.eigvalsh(matrix.toarray()) < 0.0).sum()
    assert max(counts) > 0


def test_what_cannot_be_solved_is_refused():
    model, panels, nodes = sewn_tube(2, 1)
    parameters = model.parameters(panels, WOVEN)
    rest, x = model.rest(parameters.panels), model.state(nodes).x
    with pytest.raises(InputError, match="finite forces"):
        superlu(elastic_hessian(model, rest, parameters, x * np.nan, definite=True))
    with pytest.raises(InputError, match="regular system"):
        superlu(0.0 * elastic_hessian(model, rest, parameters, x, definite=True))


def test_meshes_that_are_no_garment_are_refused():
    panel, faces = strip(2, 1, length_m=0.2, width_m=0.1)
    nothing = np.zeros((0, 3), dtype=int)
    for wrong, panel_faces in ((nothing, None), (faces, faces[:-1]), (faces + 1, None), (faces, faces[::-1])):
        with pytest.raises(MeshError):
            ClothModel(wrong, panel_faces=panel_faces)
    with pytest.raises(InputError, match="fixed"):
        ClothModel(faces, fixed=np.array([99]))
    model = ClothModel(faces, fixed=np.array([0]))
    with pytest.raises(MeshError, match="collapsed"):
        model.parameters(panel * [1.0, 0.0], WOVEN)
    with pytest.raises(MeshError, match="shape"):
        model.parameters(panel[:-1], WOVEN)
    with pytest.raises(InputError, match="finite"):
        model.state(np.full((len(panel), 3), np.nan))
    with pytest.raises(InputError, match="velocities"):
        model.state(lifted(panel), np.ones((len(panel), 3)))


@pytest.mark.parametrize("change", [{"h00": 0.0}, {"h01": 60.0}, {"bending_j": -1.0}, {"density_kg_m2": np.nan}])
def test_a_cloth_that_gives_way_is_refused(change):
    with pytest.raises(InputError, match="orthotropic material"):
        OrthotropicMaterial(**{**vars(WOVEN), **change})
