"""The network's laws: what it starts as, what it must not depend on, and the fast path against the readable one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.geometry import jets
from drape.geometry.rotations import matrix_to_rotvec, rotvec_to_matrix
from drape.graph.feeds import body_feed
from drape.graph.inputs import ChartTensors
from tests.training.training_setup import JERSEY, TINY, bank, body, garment, source
from training import losses
from training.chart_consensus import agreed_jets, closing_jets
from training.config import ModelConfig, as_published
from training.layers import SURROUNDINGS_COUNT, Decoder, GarmentEncoder, Standardise
from training.onefit import OneFit, Posed, patch_surroundings, pose_frames, posed_coefficients, vertex_positions


def batch(count: int = 3, seed: int = 0):
    rng = np.random.default_rng(seed)
    return source().pose(bank().draw(count, rng), np.zeros((count, body().shape_count)))


def posed(count: int = 3) -> Posed:
    rotation, centre = pose_frames(batch(count).tensors, garment().partitions[0].patches)
    jet = torch.randn(*centre.shape[:2], jets.JET_COUNT, generator=torch.Generator().manual_seed(1))
    return Posed(rotation, centre, 0.05 * jet)


def test_sparse_blend_equals_the_readable_form_forward_and_backward():
    partition = garment().partitions[0]
    state = posed()
    jet_fast = state.jet.clone().requires_grad_()
    jet_slow = state.jet.clone().requires_grad_()
    scale = partition.patches.scale
    fast = losses.vertices_from(posed_coefficients(replace(state, jet=jet_fast), scale), partition)
    row = partition.chart_row
    charts = ChartTensors(partition.chart_patch, partition.chart_weight, row[..., 4:], row[..., 1:4])
    slow = vertex_positions(replace(state, jet=jet_slow), partition.patches, charts)
    assert_allclose(fast.detach(), slow.detach(), rtol=0, atol=2e-6)
    cotangent = torch.randn(fast.shape, generator=torch.Generator().manual_seed(2))
    (fast * cotangent).sum().backward()
    (slow * cotangent).sum().backward()
    assert jet_fast.grad is not None
    assert jet_slow.grad is not None
    assert_allclose(jet_fast.grad, jet_slow.grad, rtol=1e-4, atol=1e-4)


def test_zero_output_at_rest_is_the_rest_garment():
    partition = garment().partitions[0]
    still = source().pose(np.zeros((1, 24, 3)), np.zeros((1, body().shape_count)))
    rotation, centre = pose_frames(still.tensors, partition.patches)
    jet = torch.zeros(1, centre.shape[1], jets.JET_COUNT)
    vertices = losses.vertices_from(
        posed_coefficients(Posed(rotation, centre, jet), partition.patches.scale), partition
    )
    expected = garment().rest.vertices - body().joints_template[0]
    assert_allclose(vertices[0], expected, rtol=0, atol=1e-5)


def test_a_vertex_is_the_blend_of_its_vector_jets():
    """Against drape.geometry.jets evaluated chart by chart in float64."""
    partition, state = garment().partitions[0], posed(1)
    patches = partition.patches
    got = losses.vertices_from(posed_coefficients(state, patches.scale), partition)[0].numpy()
    rng = np.random.default_rng(5)
    for vertex in rng.choice(len(got), 12, replace=False):
        total = np.zeros(3)
        for slot in range(4):
            k = int(partition.chart_patch[vertex, slot])
            row = partition.chart_row[vertex, slot].double().numpy()
            uv = row[[5, 6]]  # the basis is 1, u, v, ...
            jet = state.jet[0, k].double().numpy()
            local = row[1:4] + float(patches.scale[k]) * jets.evaluate_jet(jet, uv)
            total += float(partition.chart_weight[vertex, slot]) * (
                state.centre[0, k].double().numpy() + state.rotation[0, k].double().numpy() @ local
            )
        assert_allclose(got[vertex], total, rtol=0, atol=2e-6)


def test_turning_the_body_about_the_vertical_turns_the_drape():
    torch.manual_seed(0)
    model = OneFit(ModelConfig()).eval()
    for head in model.decoder.heads.values():
        torch.nn.init.normal_(list(head.parameters())[-2], std=0.05)
    partition = garment().partitions[0]
    poses = bank().draw(2, np.random.default_rng(3))
    turn = rotvec_to_matrix(np.array([0.0, 2.1, 0.0]))
    turned = poses.copy()
    turned[:, 0] = matrix_to_rotvec(turn @ rotvec_to_matrix(poses[:, 0]))
    betas = np.zeros((2, body().shape_count))
    with torch.no_grad():
        embedding = model.garment(partition.encoder_inputs(JERSEY))
        outputs = []
        for set_of_poses in (poses, turned):
            state = model(
                source().pose(set_of_poses, betas).tensors, partition.patches, embedding, charts=partition.consensus
            )
            outputs.append(losses.vertices_from(posed_coefficients(state, partition.patches.scale), partition).numpy())
    assert np.abs(outputs[0]).max() > 0.1
    assert_allclose(outputs[1], outputs[0] @ turn.T, rtol=0, atol=2e-4)


def test_surroundings_are_joints_and_gravity_in_the_patch_frame():
    """Written out joint by joint; far joints saturate at length one, and turning the world changes only gravity."""
    partition, bodies = garment().partitions[0], batch(2).tensors
    rotation, centre = pose_frames(bodies, partition.patches)
    got = patch_surroundings(bodies, rotation, centre).double().numpy()
    assert bodies.joints is not None
    for frame, patch, joint in ((0, 0, 0), (0, 3, 20), (1, 5, 7)):
        offset = (bodies.joints[frame, joint] - centre[frame, patch]).double().numpy()
        local = rotation[frame, patch].double().numpy().T @ offset
        reach = np.linalg.norm(local)
        wanted = local / reach * np.tanh(reach / 0.3)
        assert_allclose(got[frame, patch, 3 * joint : 3 * joint + 3], wanted, rtol=0, atol=2e-5)
        gravity = rotation[frame, patch].double().numpy().T @ np.array([0.0, -1.0, 0.0])
        assert_allclose(got[frame, patch, 72:], gravity, rtol=0, atol=1e-6)


def test_joints_of_a_batch_are_those_of_the_body_model():
    poses, betas = bank().draw(2, np.random.default_rng(8)), np.random.default_rng(9).normal(size=(2, 10))
    joints = source().pose(poses, betas).tensors.joints
    assert joints is not None
    for n in range(2):
        feed = body_feed(body(), poses[n : n + 1], np.zeros((1, 3)), betas[n])
        assert_allclose(joints[n], feed.arrays["body_joints"][0], rtol=0, atol=2e-6)


def test_untrained_network_stays_near_plain_skinning():
    torch.manual_seed(0)
    model = OneFit(ModelConfig()).eval()
    partition = garment().partitions[0]
    with torch.no_grad():
        embedding = model.garment(partition.encoder_inputs(JERSEY))
        state = model(batch().tensors, partition.patches, embedding, charts=partition.consensus)
        plain = model(batch().tensors, partition.patches, embedding, charts=partition.consensus, passes=0)
        rotation, centre = pose_frames(batch().tensors, partition.patches)
        frames = torch.cat([centre[..., None, :], rotation.mT], dim=-2)
        charts, scale = partition.consensus, partition.patches.scale
        base = agreed_jets(charts.anchors(frames), charts, rotation, centre, scale)
        said = charts.anchors(posed_coefficients(Posed(rotation, centre, base), scale))
        base = closing_jets(said, charts, rotation, centre, scale)
    assert float((plain.jet - base).abs().max()) < 1e-2
    assert float((state.jet - base).abs().max()) < 0.5  # agreement alone moves charts a little


def test_paper_variant_moves_patches_by_translation_and_scale():
    """Its heads written as a vector jet must equal s (1 + ds) (u, v) + dT and the added height."""
    torch.manual_seed(0)
    model = OneFit(as_published(TINY)).eval()
    for head in model.decoder.heads.values():
        torch.nn.init.normal_(list(head.parameters())[-2], std=0.3)
    partition = garment().partitions[0]
    bodies = batch()
    with torch.no_grad():
        embedding = model.garment(partition.encoder_inputs(None))
        out, _ = model.decoder(model.body(bodies.tensors.features), embedding)
        jet, _ = model.predict(bodies.tensors, embedding)
        state = model(bodies.tensors, partition.patches, embedding)
    uv = torch.tensor([0.3, -0.6])
    got = jets.evaluate_jet(jet, uv) / model.config.output_gain
    shift, scale, height = out["translation"], out["scale"], out["height"]
    assert_allclose(got[..., :2], shift[..., :2] + scale * uv, rtol=0, atol=1e-5)
    polynomial = (height * jets.basis(uv, jets.HEIGHT_ORDER)).sum(-1)
    assert_allclose(got[..., 2], shift[..., 2] + polynomial, rtol=0, atol=1e-5)
    assert_allclose(state.rotation[0], partition.patches.rotation, rtol=0, atol=0)


def test_unknown_variant_is_refused():
    with pytest.raises(ValueError, match="variant"):
        OneFit(replace(TINY, variant="nonsense"))


def test_decoder_equals_layers_on_the_concatenated_codes():
    """The split first layer is the product with the concatenation of both codes (section 3) and the surroundings."""
    torch.manual_seed(1)
    decoder = Decoder(TINY, {"out": 5})
    assert decoder.from_surroundings is not None
    code, embedding = torch.randn(4, TINY.body_code_size), torch.randn(7, TINY.embedding_size)
    around = torch.randn(4, 7, SURROUNDINGS_COUNT + jets.JET_COUNT)
    weight = torch.cat([decoder.from_body.weight, decoder.from_patch.weight, decoder.from_surroundings.weight], dim=1)
    both = torch.cat([code[:, None].expand(-1, 7, -1), embedding[None].expand(4, -1, -1), around], dim=-1)
    first = torch.nn.functional.leaky_relu(both @ weight.T + decoder.from_patch.bias, 0.01)
    expected = decoder.heads["out"](decoder.trunk(first))
    assert_allclose(decoder(code, embedding, around)[0]["out"].detach(), expected.detach(), rtol=1e-4, atol=1e-6)


def test_standardise_has_unit_statistics_and_bounds_strangers():
    layer = Standardise(3)
    samples = torch.randn(4000, 3, generator=torch.Generator().manual_seed(0)) * torch.tensor([2.0, 5.0, 0.0]) + 7.0
    layer.set_from(samples)
    out = layer(samples)
    assert_allclose(out[:, :2].std(dim=0), [1.0, 1.0], rtol=2e-2, atol=0)
    assert_allclose(out.mean(dim=0), [0.0, 0.0, 0.0], rtol=0, atol=1e-4)
    assert float(layer(torch.full((1, 3), 1e9)).abs().max()) == 5.0


def test_garment_encoder_treats_patches_alone():
    torch.manual_seed(3)
    encoder = GarmentEncoder(TINY)
    features = torch.randn(9, TINY.encoder_feature_count)
    assert_allclose(encoder(features)[4:5].detach(), encoder(features[4:5]).detach(), rtol=1e-5, atol=1e-6)
