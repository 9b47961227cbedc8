"""A model between two."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from drape.artifacts import MODELS_DIR
from drape.errors import InputError
from tests.fixtures.networks import TINY
from training import checkpoint
from training.average import interpolate_weights, main
from training.config import TrainConfig
from training.onefit import OneFit
from training.starting import load_exported


def weights(seed: int) -> dict[str, torch.Tensor]:
    torch.manual_seed(seed)
    return OneFit(TINY).state_dict()


def test_the_command_writes_the_mean_of_two_models_that_can_be_read_again(tmp_path: Path):
    first, second = weights(0), weights(1)
    config = TrainConfig(model=TINY)
    for name, model, step in (("a.pt", first, 5), ("b.pt", second, 7)):
        checkpoint.save(tmp_path / name, {"model": model, "step": step, "optimiser": {}}, config)
    assert main([str(tmp_path / "a.pt"), str(tmp_path / "b.pt"), "--out", str(tmp_path / "c.pt")]) == 0
    payload, read = checkpoint.load_checkpoint(tmp_path / "c.pt")
    assert read == config and payload["step"] == 7 and "optimiser" not in payload
    moved = 0
    for name, value in payload["model"].items():
        torch.testing.assert_close(value, 0.5 * (first[name] + second[name]))
        moved += not torch.equal(value, second[name])
    assert moved > 5
    OneFit(TINY).load_state_dict(payload["model"])


def test_an_exported_model_may_be_the_first(tmp_path: Path):
    shipped, config, _ = load_exported(MODELS_DIR / "onefit")
    second = {name: value + 1.0 if value.is_floating_point() else value for name, value in shipped.items()}
    checkpoint.save(tmp_path / "b.pt", {"model": second, "step": 1}, TrainConfig(model=config))
    assert main(["onefit", str(tmp_path / "b.pt"), "--share", "0.7", "--out", str(tmp_path / "c.pt")]) == 0
    found = checkpoint.load_checkpoint(tmp_path / "c.pt")[0]["model"]
    for name, value in shipped.items():
        torch.testing.assert_close(found[name], value + 0.7 if value.is_floating_point() else value)


@pytest.mark.parametrize(("share", "of"), [(0.0, 0), (1.0, 1)])
def test_its_ends_are_the_two(share: float, of: int):
    both = weights(0), weights(1)
    for name, value in interpolate_weights(*both, share).items():
        assert torch.equal(value, both[of][name])


def test_what_cannot_be_averaged_is_refused(tmp_path: Path, capsys):
    first, second = weights(0), weights(1)
    with pytest.raises(InputError, match="--share: expected a number from 0 to 1"):
        interpolate_weights(first, second, 1.5)
    name = next(iter(second))
    with pytest.raises(InputError, match=f"expected the same network twice, got {name} in one"):
        interpolate_weights(first, {key: value for key, value in second.items() if key != name}, 0.5)
    with pytest.raises(InputError, match="or of two sizes"):
        interpolate_weights(first | {name: torch.zeros(2, 3, 4)}, second, 0.5)
    assert main([str(tmp_path / "no.pt"), str(tmp_path / "no.pt"), "--out", str(tmp_path / "c.pt")]) == 2
    assert "checkpoint no.pt" in capsys.readouterr().err
