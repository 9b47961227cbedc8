"""The exported orientation network: parity, symbolic axes, manifest, refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.artifacts import MODELS_DIR, load_manifest
from drape.errors import ArtifactError
from drape.garment.canonical import canonical, polyfit_orient
from drape.geometry.rotations import quaternion_to_matrix
from model_export import polyfit as exporting
from training.polyfit import fit
from training.polyfit.config import Kind, PolyFitConfig
from training.polyfit.families import FAMILIES, draw_patches
from training.polyfit.train import Trainer, save

pytestmark = pytest.mark.slow


def checkpoint(folder: Path, kind: Kind = "qstn"):
    trainer = Trainer(PolyFitConfig(kind=kind, steps=0))
    last = list(list(trainer.model.children())[-1].children())[-1]
    assert isinstance(last, torch.nn.Linear)
    torch.nn.init.normal_(last.weight, std=0.3)
    save(folder / f"{kind}.pt", trainer)
    return trainer.model, folder / f"{kind}.pt"


def test_any_number_of_patches_and_points_agrees_with_torch(tmp_path, rng):
    model, path = checkpoint(tmp_path)
    manifest = exporting.export_polyfit(path, tmp_path / "polyfit")
    assert load_manifest(tmp_path / "polyfit") == manifest
    assert manifest.parity_error_m < exporting.TOLERANCE
    assert manifest.training["command"] == "python -m training.polyfit --only qstn"
    assert sum(file.stat().st_size for file in (tmp_path / "polyfit").iterdir()) < 1_500_000
    transform = exporting.runtime_transform(tmp_path / "polyfit" / "polyfit.onnx")
    for patches, points in ((1, 1), (2, 7), (33, 150)):
        cloud = rng.normal(size=(patches, points, 3)).astype(np.float32)
        with torch.no_grad():
            assert_allclose(transform(cloud), model(torch.from_numpy(cloud)).numpy(), rtol=0, atol=1e-5)
    frame = quaternion_to_matrix(polyfit_orient(transform)(rng.normal(size=(40, 3)) * [1.0, 0.8, 0.1]))
    assert_allclose(frame.T @ frame, np.eye(3), rtol=0, atol=1e-6)


def test_a_regressor_is_no_transformer(tmp_path):
    _, path = checkpoint(tmp_path, "pointnet")
    with pytest.raises(ArtifactError, match="quaternion transformer"):
        exporting.export_polyfit(path, tmp_path / "polyfit")
    assert not (tmp_path / "polyfit").exists()


def test_a_graph_that_differs_is_refused(tmp_path, monkeypatch):
    _, path = checkpoint(tmp_path)
    monkeypatch.setattr(exporting, "TOLERANCE", -1.0)
    with pytest.raises(ArtifactError, match="parity"):
        exporting.export_polyfit(path, tmp_path / "polyfit")
    assert not (tmp_path / "polyfit").exists()


def test_the_shipped_network_is_whole_and_turns_a_patch():
    folder = MODELS_DIR / "polyfit"
    manifest = load_manifest(folder)  # refuses a file that is not the one its digest names
    assert manifest.parity_error_m < exporting.TOLERANCE
    assert manifest.training["steps"] > 0 and manifest.graphs["polyfit"].inputs == exporting.INPUTS
    assert sum(file.stat().st_size for file in folder.iterdir()) < 1_500_000
    drawn = draw_patches(40, 64, families=FAMILIES, seed=(3, 3))
    local = canonical(drawn.points).local
    quaternion = exporting.runtime_transform(folder / "polyfit.onnx")(local.numpy())
    assert_allclose(np.linalg.norm(quaternion, axis=1), 1.0, rtol=0, atol=1e-5)
    turned = fit.turned(local, torch.from_numpy(quaternion))
    before, after = (float(fit.height_rmse(fit.fit_jet(x, order=4)).mean()) for x in (local, turned))
    assert after < before  # of patches like those it was trained on


def test_the_command_says_what_is_wrong(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["polyfit", str(tmp_path / "none.pt"), str(tmp_path / "out")])
    assert exporting.main() == 2
