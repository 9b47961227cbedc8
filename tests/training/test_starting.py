"""What a run starts from: exported weights read back whole, fine-tuning on one garment, refusals."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.artifacts import MODELS_DIR, load_manifest
from drape.catalog import MOTIONS_DIR
from drape.errors import ArtifactError, InputError
from drape.garment.cache import GARMENTS_DIR
from tests.fixtures.packed import MOVING, SMALL, exported, exported_dynamic
from tests.training.training_setup import CPU, TINY, TINY_RUN
from training import checkpoint, run
from training.config import TrainConfig, dynamic, shipped
from training.onefit import OneFit
from training.poses import read_training_clips
from training.run import make_trainer
from training.starting import finetune_from, load_exported, read_model, start_from, with_garments

TANK, SHORTS = (str(next(GARMENTS_DIR.glob(f"{name}-*.npz"))) for name in ("tank", "shorts"))


@pytest.fixture
def tiny(tmp_path: Path) -> tuple[OneFit, Path]:
    """A tiny static network and the folder of its run."""
    torch.manual_seed(3)
    made = OneFit(TINY)
    data = replace(TINY_RUN.data, held_out=("walk",))
    checkpoint.save(tmp_path / "run" / "checkpoint.pt", {"model": made.state_dict()}, replace(TINY_RUN, data=data))
    return made, tmp_path / "run"


def same(weights: dict[str, torch.Tensor], model: OneFit) -> bool:
    wanted = model.state_dict()
    return weights.keys() == wanted.keys() and all(torch.equal(weights[key], wanted[key]) for key in wanted)


# --- exported models ---


@pytest.mark.slow
@pytest.mark.parametrize("make", [exported, exported_dynamic], ids=["static", "dynamic"])
def test_an_exported_model_gives_its_static_weights_back(make):
    model, folder, _ = make()
    weights, config, held_out = load_exported(folder)
    assert config == replace(model.config, dynamic=False) and held_out == ()
    static = OneFit(SMALL)
    static.load_state_dict({k: v for k, v in model.state_dict().items() if not k.startswith("dynamic.")})
    assert same(weights, static)


def test_the_shipped_model_gives_a_network_that_computes_its_graph():
    weights, config, held_out = load_exported(MODELS_DIR / "onefit")
    model = OneFit(config)
    model.load_state_dict(weights)
    assert held_out == tuple(load_manifest(MODELS_DIR / "onefit").training["held_out"])
    from model_export.parity import session
    from model_export.readable_graphs import EncoderGraph

    features = np.random.default_rng(0).normal(size=(5, config.encoder_feature_count)).astype(np.float32)
    with torch.no_grad():
        got = EncoderGraph(model.eval())({"patch_features": torch.from_numpy(features)}).numpy()
    encoder = session(MODELS_DIR / "onefit" / "garment_encoder.onnx")
    want = np.asarray(encoder.run(["patch_embedding"], {"patch_features": features})[0])
    assert_allclose(got, want, rtol=0, atol=1e-4)


@pytest.mark.parametrize("fault", ["no weights", "a name is missing", "a shape differs", "an unknown size"])
def test_a_model_without_a_networks_weights_is_refused(tmp_path: Path, fault: str):
    folder = Path(shutil.copytree(MODELS_DIR / "onefit", tmp_path / "onefit"))
    manifest = load_manifest(folder)
    weights, network, name = manifest.weights, dict(manifest.network), "decoder.trunk.0.bias"
    assert weights is not None
    parameters = dict(weights.parameters)
    if fault == "a name is missing":
        del parameters[name]
    elif fault == "a shape differs":
        parameters[name] = replace(parameters[name], shape=(7,))
    elif fault == "an unknown size":
        network["of_another_program"] = 3
    weights = None if fault == "no weights" else replace(weights, parameters=parameters)
    (folder / "manifest.json").write_text(replace(manifest, weights=weights, network=network).to_json())
    with pytest.raises(ArtifactError, match="model onefit: expected the weights of a draping network"):
        load_exported(folder)


# --- what --from and --finetune take ---


def test_a_run_a_checkpoint_and_a_name_are_models(tiny: tuple[OneFit, Path]):
    model, folder = tiny
    for path in (folder, folder / "checkpoint.pt"):
        weights, config, held_out = read_model(path)
        assert same(weights, model) and config == TINY and held_out == ("walk",)
    named, config, _ = read_model(Path("onefit"))
    assert named["decoder.from_body.weight"].shape == (config.decoder_sizes[0], config.body_code_size)


@pytest.mark.parametrize("name", ["no_such_model", "run"])
def test_a_model_that_is_not_there_is_refused(tmp_path: Path, name: str):
    (tmp_path / "run").mkdir()  # a folder with nothing in it
    with pytest.raises(InputError, match="model to start from: expected a checkpoint"):
        read_model(tmp_path / name)


def test_garments_take_the_place_of_the_presets():
    config = with_garments(TrainConfig(), [TANK, "skirt"])
    assert (config.data.garments, config.data.variants, config.data.own_share) == ((TANK, "skirt"), 0, 1.0)
    assert with_garments(TrainConfig(), None) == TrainConfig()


# --- fine-tuning ---


def test_fine_tuning_starts_from_the_model_on_the_garment_alone(tiny: tuple[OneFit, Path]):
    model, folder = tiny
    config, weights = finetune_from(folder, [TANK])
    assert config.data.garments == (TANK,) and config.data.held_out == ("walk",) and config.early_agreement == 1.0
    config = replace(config, data=replace(config.data, partitions=1), batch_size=2, threads=1)
    trainer = make_trainer(config, read_training_clips([MOTIONS_DIR], held_out=()), device=CPU, weights=weights)
    assert [garment.name for garment in trainer.wardrobe.garments] == [TANK]
    assert same(trainer.model.state_dict(), model), "weights and statistics are the model's"
    trainer.step()
    assert not same(trainer.model.state_dict(), model)


def test_without_a_garment_training_goes_on_with_those_of_the_preset(tiny: tuple[OneFit, Path]):
    model, folder = tiny
    config, weights = finetune_from(folder, None)
    assert config.data == replace(shipped().data, held_out=("walk",)) and config.model == TINY
    assert (config.early_agreement, config.minutes) == (1.0, shipped().minutes)
    assert config.learning_rate < shipped().learning_rate and same(weights, model)


def test_of_a_dynamic_model_the_static_drape_is_fine_tuned(tmp_path: Path):
    moving = OneFit(MOVING)
    checkpoint.save(tmp_path / "checkpoint.pt", {"model": moving.state_dict()}, replace(TINY_RUN, model=MOVING))
    config, weights = finetune_from(tmp_path, ["skirt"])
    assert config.model == replace(MOVING, dynamic=False)
    assert weights.keys() == OneFit(SMALL).state_dict().keys()


@pytest.mark.slow
def test_the_command_line_fine_tunes(tiny: tuple[OneFit, Path], tmp_path: Path, monkeypatch, capsys):
    _, folder = tiny

    def with_one_partition(*asked):
        config, weights = finetune_from(*asked)
        return replace(config, data=replace(config.data, partitions=1)), weights

    monkeypatch.setattr(run, "finetune_from", with_one_partition)
    options = ["--finetune", str(folder), "--garment", TANK, "--beside", SHORTS, "--motions", str(MOTIONS_DIR)]
    options += ["--out", str(tmp_path / "out"), "--minutes", "0.005", "--threads", "1", "--device", "cpu"]
    options += ["--batch", "2", "--bf16"]
    monkeypatch.setattr("sys.argv", ["run", *options])
    assert run.main() == 0
    payload, config = checkpoint.load_checkpoint(tmp_path / "out" / "checkpoint.pt")
    assert config.batch_size == 2 and config.autocast
    assert payload["step"] >= 1 and config.data.garments == (TANK, SHORTS) and config.model == TINY
    assert f"stored    {tmp_path / 'out' / 'checkpoint.pt'}: step {payload['step']} after" in capsys.readouterr().out
    assert run.main() == 2  # a second run there would write over the first
    assert "--out: expected a folder without an earlier run" in capsys.readouterr().err
    monkeypatch.setattr("sys.argv", ["run", "--resume", str(tmp_path / "out"), "--motions", str(MOTIONS_DIR)])
    assert run.main() == 0
    assert "nothing left to do: the run has had its 0.005 minutes" in capsys.readouterr().out
    assert checkpoint.load_checkpoint(tmp_path / "out" / "checkpoint.pt")[0]["step"] == payload["step"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--resume", "runs/shirt", "--garment", TANK], "--garment: expected nothing with --resume"),
        (["--resume", "runs/shirt", "--beside", TANK], "--beside: expected nothing with --resume"),
        (["--beside", "no_such_file"], "garment: expected one of"),
        (["--finetune", "no_such_model", "--garment", TANK], "model to start from: expected a checkpoint"),
    ],
)
def test_options_that_do_not_fit_are_refused(options: list[str], message: str, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["run", *options])
    assert run.main() == 2
    assert message in capsys.readouterr().err


def test_a_static_model_takes_over_the_motion_of_an_exported_one(tiny: tuple[OneFit, Path]):
    moving, folder, _ = exported_dynamic()
    config, weights = start_from(dynamic(), tiny[1], folder)
    assert weights is not None
    assert (config.model.state_size, config.model.motion_hidden) == (MOVING.state_size, MOVING.motion_hidden)
    wanted = {name: value for name, value in moving.state_dict().items() if name.startswith("dynamic.")}
    assert all(torch.equal(weights[name], value) for name, value in wanted.items())
    with pytest.raises(ArtifactError, match="expected a model that knows motion"):
        start_from(dynamic(), tiny[1], exported()[1])
