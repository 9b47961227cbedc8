"""Spaces against independent computations: skinning, the product's own drape, jets evaluated one by one."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from benchmarks.papers.representation import frame_spaces, posed_frames
from benchmarks.papers.representation_space import (
    REPRESENTATIONS,
    PatchSpace,
    VertexSpace,
    block_scaling,
    cotangent_laplacian,
    embedding,
)
from drape.body.assets import load_body
from drape.contact.skin import body_skin
from drape.garment.cache import Atlas
from drape.geometry import jets
from drape.geometry.rotations import rotvec_to_matrix
from drape.geometry.skinning import skin_points
from tests.benchmarks.papers.representation_setup import bench, found, garment
from tests.drape.cloth.cloth_shapes import grid

FORMS = list(REPRESENTATIONS.values())


def drawn(space: PatchSpace, size: float, seed: int = 0) -> tuple[torch.Tensor, np.ndarray]:
    """Random numbers (K, n) of ``size`` [patch scales, rad], and the variables that mean them."""
    count = space.charts.patch_count
    numbers = torch.from_numpy(np.random.default_rng(seed).normal(0.0, size, (count, space.size // count))).float()
    return space.scaling.variables(numbers), numbers.double().numpy()


def atlas() -> Atlas:
    return Atlas(**{item.name: getattr(garment(), item.name) for item in fields(Atlas)})


def test_a_rigid_form_is_the_product_s_drape():
    """The product's vertices are those of training.losses, for the same jets in the same posed frames."""
    from training.data import partition_tensors
    from training.losses import vertices_from
    from training.model import Posed, posed_coefficients

    partition = partition_tensors(atlas(), body_skin(load_body()), device=torch.device("cpu"))
    for space, (rotation, centre) in zip(
        frame_spaces(bench(), REPRESENTATIONS["rigid_2"], found()), posed_frames(bench(), found()), strict=True
    ):
        z, numbers = drawn(space, 0.05)
        jet = np.concatenate([numbers[:, 15:], numbers[:, :15]], axis=1)  # p, q, h
        posed = Posed(*(torch.from_numpy(a).float()[None] for a in (rotation, centre, jet)))
        expected = vertices_from(posed_coefficients(posed, partition.patches.scale), partition)[0]
        assert_allclose(space.positions(z).numpy(), expected.numpy(), rtol=0, atol=3e-6)


@pytest.mark.parametrize("form", FORMS, ids=lambda f: f.name)
def test_positions_are_the_blend_of_turned_polynomials(form):
    """Everything again in float64 from the patch fields: turn, polynomials, blend, then skinning."""
    got_fields: dict[str, np.ndarray] = {
        k: v.astype(np.float64) if v.dtype.kind == "f" else v for k, v in vars(atlas()).items()
    }
    patch, uv, weight = got_fields["chart_patch"], got_fields["chart_uv"], got_fields["chart_weight"]
    scale = got_fields["patch_scale"][patch][..., None]
    rest_jet = got_fields["patch_jet"][patch]
    place = scale * jets.evaluate(rest_jet, uv) + got_fields["chart_residual"]
    space = frame_spaces(bench(), form, found())[1]
    z, numbers = drawn(space, 0.05)
    own = numbers[patch]
    added = np.zeros_like(place)
    added[..., 2] = np.sum(own[..., :15] * jets.basis(uv, 4), axis=-1)
    if form.plane_order is None:
        p, q, _ = jets.unpack(rest_jet)
        plane = jets.basis(uv, 2)
        added[..., 0] = own[..., 15] + own[..., 17] * np.sum(p * plane, axis=-1)
        added[..., 1] = own[..., 16] + own[..., 17] * np.sum(q * plane, axis=-1)
    else:
        basis = jets.basis(uv, form.plane_order)
        count = basis.shape[-1]
        added[..., 0] = np.sum(own[..., 15 : 15 + count] * basis, axis=-1)
        added[..., 1] = np.sum(own[..., 15 + count : 15 + 2 * count] * basis, axis=-1)
    local = place + scale * added
    rotation, centre = (found().rotation, found().centre) if form.skinned else posed_frames(bench(), found())[1]
    if form.turns:
        rotation = rotation @ rotvec_to_matrix(numbers[:, -3:])
    said = np.einsum("vkab,vkb->vka", rotation[patch], local) + centre[patch]
    expected = np.einsum("vk,vka->va", weight, said)
    if form.skinned:
        rotations, translations = bench().bones
        expected = skin_points(expected, bench().rest.binding.weights, rotations[1], translations[1])
    assert_allclose(space.positions(z).numpy(), expected, rtol=0, atol=4e-6)


def test_numbers_per_patch_are_what_is_embedded():
    counts = {form.name: form.number_count for form in FORMS}
    assert counts == {
        "paper": 18, "paper_turning": 21, "skinned_2": 27, "rigid_1": 21, "rigid_2": 27, "rigid_3": 35,
    }  # fmt: skip
    for form in FORMS:
        assert embedding(form, found().rest_jet).shape == (found().patch_count, 45, form.number_count)


def test_a_small_turn_is_its_column():
    """To first order a turned patch moves as the three columns of its embedding say."""
    form = REPRESENTATIONS["paper_turning"]
    columns = embedding(form, found().rest_jet)[:, :, -3:]
    uv, angle = np.array([0.3, -0.4]), np.array([1e-5, -2e-5, 3e-5])
    rest = jets.evaluate(found().rest_jet, np.broadcast_to(uv, (found().patch_count, 2)))
    turned = rest @ rotvec_to_matrix(angle).T - rest
    by_columns = (columns @ angle).reshape(-1, 3, 15) @ jets.basis(uv, 4)
    assert_allclose(by_columns, turned, rtol=0, atol=2e-9)


def test_scalings_invert_and_whiten():
    form = REPRESENTATIONS["rigid_2"]
    scaling = block_scaling(form, found())
    z = torch.randn(scaling.size, generator=torch.Generator().manual_seed(0))
    assert_allclose(scaling.variables(scaling.numbers(z)).numpy(), z.numpy(), rtol=0, atol=2e-3)
    columns = embedding(form, found().rest_jet)
    hessian = columns.transpose(0, 2, 1) @ found().gram @ columns
    numbers = scaling.numbers(z).double().numpy()
    energy = np.einsum("ki,kij,kj->k", numbers, hessian, numbers)
    assert_allclose(energy, (z.double().numpy().reshape(len(energy), -1) ** 2).sum(axis=1), rtol=0.02, atol=0)


def test_vertex_space_scales_by_stiffness():
    start, stiffness = bench().judge.skinned[0], np.linspace(1.0, 4.0, len(bench().judge.skinned[0]))
    space = VertexSpace(start, stiffness)
    assert space.size == start.size
    moved = space.positions(torch.ones(space.size)).numpy() - start
    assert_allclose(moved, np.repeat(1.0 / np.sqrt(stiffness)[:, None], 3, axis=1), rtol=0, atol=1e-6)


def test_laplacian_of_a_linear_field_is_its_gradient():
    """On a triangulated square of side 2 the integral of |grad (3 x - y)|^2 is 10 times its area."""
    vertices, faces = grid(8, 8, cell_m=0.25)
    laplacian = cotangent_laplacian(vertices, faces)
    field = 3.0 * vertices[:, 0] - vertices[:, 1]
    assert_allclose(field @ (laplacian @ field), 40.0, rtol=1e-12, atol=0)
    assert_allclose(np.asarray(laplacian.sum(axis=1)), 0.0, rtol=0, atol=1e-12)
