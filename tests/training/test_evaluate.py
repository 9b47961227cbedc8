"""The quick look at a checkpoint: its drape is the network's, its energies are the benchmark's."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.errors import ArtifactError
from drape.files.data import DATA_VARIABLE
from drape.garment.cache import save_garment
from drape.geometry.skinning import skin_points
from drape.graph.feeds import body_feed
from drape.motion.clip import MotionClip
from drape.motion.hard_poses import HardPoses
from tests.fixtures.garments import reconstructed
from tests.fixtures.tiny_model import skinned_vertices
from tests.training.training_setup import TINY, TINY_RUN, body, source
from training import checkpoint
from training.config import as_published
from training.disagreement import chart_positions
from training.evaluate import evaluate, held_out_clips, load_network, main, posed_patches
from training.onefit import OneFit

METHODS = ["skinning", "skinning_push", "network", "network_push"]


def network(variant: str = "vector", *, silent: bool = False) -> OneFit:
    """A tiny network; ``silent`` adds nothing to the jets."""
    torch.manual_seed(1)
    torch.set_num_threads(1)
    config = TINY if variant == "vector" else as_published(TINY)
    return OneFit(replace(config, output_gain=0.0 if silent else 5.0)).eval()


def bend() -> np.ndarray:
    poses = np.zeros((2, 24, 3))
    poses[1, [3, 6], 0] = 0.4
    poses[1, 0, 1] = 0.8
    return poses


def test_a_silent_network_turns_the_garment_with_the_body(tube):
    # The tiny model of the service tests does the same, in float64 and without torch; features zero: no lift.
    garment, poses = replace(tube, patch_features=np.zeros_like(tube.patch_features)), bend()
    poses[:, 1:] = 0.0  # where patches turn against each other their charts are brought to agree
    vertices, posed = posed_patches(network(silent=True), garment, source(), poses)
    expected = skinned_vertices(body(), garment, poses)
    assert_allclose(vertices, expected, rtol=0.0, atol=2e-6)
    assert posed.rotation.shape == (2, garment.patch_count, 3, 3)


def test_vertices_are_the_blend_of_the_posed_patches(tube):
    vertices, posed = posed_patches(network(), tube, source(), bend())
    said = chart_positions(tube, posed.jet.numpy(), posed.rotation.numpy(), posed.centre.numpy())
    root = body_feed(body(), bend(), np.zeros((2, 3))).root
    blended = np.einsum("vk,fvka->fva", tube.chart_weight, said) + root[:, None]
    assert np.abs(posed.jet.numpy()).max() > 1e-4
    assert_allclose(vertices, blended, rtol=0.0, atol=2e-6)


def test_the_papers_variant_is_skinned_after_it_is_deformed(tube):
    vertices, _ = posed_patches(network("paper", silent=True), tube, source(), bend())
    rest = np.broadcast_to(reconstructed(tube), (2, *tube.vertices.shape))
    expected = skin_points(rest, tube.skin_weights(body()), *body().bones(bend()))
    assert_allclose(vertices, expected, rtol=0.0, atol=2e-6)


@pytest.mark.parametrize("variant", ["vector", "paper"])
def test_rows_compare_the_network_with_skinning(variant, tube):
    rows = evaluate(network(variant), tube, body(), HardPoses(bend(), ("bend:0", "bend:1")))
    assert [row["method"] for row in rows] == METHODS
    for row in rows:
        parts = row["membrane_j"] + row["bending_j"] + row["gravity_j"] + row["contact_j"]
        assert_allclose(row["energy_j"], parts, rtol=1e-9, atol=1e-12)
        assert_allclose(row["share"] * rows[1]["energy_j"], row["energy_j"], rtol=1e-9, atol=0.0)
    assert rows[2]["chart_gap_p99_mm"] > 0.0
    assert rows[2]["chart_normal_p99_deg"] > 0.0


def test_the_command_ends_with_its_record(tmp_path, tube, capsys):
    model = network()
    checkpoint.save(tmp_path / "checkpoint.pt", {"model": model.state_dict(), "step": 12}, config_of(model))
    garment = save_garment(tube, tmp_path)
    motion = tmp_path / "sway.npz"
    sway = np.zeros((40, 24, 3))
    sway[:, 3, 0] = np.linspace(0.0, 0.5, 40)
    MotionClip(sway, np.zeros((40, 3)), 30.0, "sway").save(motion)
    arguments = [str(tmp_path), "--garments", str(garment), "--motions", str(motion), "--frames", "2"]
    record = main([*arguments, "--threads", "1"])
    printed = capsys.readouterr().out.strip().split("\n")
    assert json.loads(printed[-1]) == record
    assert len(printed) == 1 + len(METHODS) + 1
    assert record["step"] == 12
    assert [row["garment"] for row in record["rows"]] == ["tube"] * len(METHODS)
    assert all(label.startswith("sway:") for label in record["frames"])


def test_fewer_passes_drape_otherwise(tube):
    jets = [posed_patches(network(), tube, source(), bend(), passes=n)[1].jet for n in (0, 1, None)]
    assert float((jets[0] - jets[1]).abs().max()) > 1e-4
    assert torch.equal(jets[1], jets[2])  # the tiny network has one


def config_of(model: OneFit):
    return replace(TINY_RUN, model=model.config)


def test_without_motion_folder_the_shipped_clips_are_taken(monkeypatch):
    monkeypatch.delenv(DATA_VARIABLE, raising=False)
    assert "walk" in {clip.name for clip in held_out_clips(TINY_RUN, [])}
    assert [clip.name for clip in held_out_clips(TINY_RUN, ["squat"])] == ["squat"]


def test_with_a_motion_folder_the_held_out_clips_are_taken(monkeypatch, tmp_path):
    still = MotionClip(np.zeros((9, 24, 3)), np.zeros((9, 3)), 30.0, "still")
    (name, *_) = TINY_RUN.data.held_out
    for stem in (name, "seen"):
        replace(still, name=stem).save(tmp_path / "motions" / f"{stem}.npz")
    monkeypatch.setenv(DATA_VARIABLE, str(tmp_path))
    assert [clip.name for clip in held_out_clips(TINY_RUN, [])] == [name]


def test_a_checkpoint_of_another_network_is_refused(tmp_path):
    model = network()
    wider = replace(TINY_RUN, model=replace(TINY, body_hidden=24))
    checkpoint.save(tmp_path / "other.pt", {"model": model.state_dict(), "step": 1}, wider)
    with pytest.raises(ArtifactError, match=r"other.pt.*size mismatch"):
        load_network(tmp_path / "other.pt")
    checkpoint.save(tmp_path / "empty.pt", {"step": 1}, TINY_RUN)
    with pytest.raises(ArtifactError, match=r"empty.pt.*model"):
        load_network(tmp_path / "empty.pt")
    checkpoint.save(tmp_path / "good.pt", {"model": model.state_dict(), "step": 3}, config_of(model))
    loaded, config, steps = load_network(tmp_path / "good.pt")
    assert (config, steps) == (config_of(model), 3)
    assert not loaded.training
