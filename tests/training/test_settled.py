"""Settled drapes: they rest lower and hang by their fabric, files keep them, and training goes toward them."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.catalog import MOTIONS_DIR
from drape.cloth import energies
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material
from drape.errors import ArtifactError, InputError, NotFound
from tests.fixtures.packed import exported
from tests.training.training_setup import CPU, TINY, TINY_RUN, bank, body, garment, source
from training import settled
from training.run import make_trainer
from training.settled import Settler
from training.targets import SettledBank, SettledDrapes, distance, settled_digest
from training.trainer import Trainer

FABRIC_RUN = replace(TINY_RUN, model=replace(TINY, fabric=True))


def still(name: str) -> tuple[np.ndarray, np.ndarray]:
    """The tube at rest relative to the root, and where it settles in ``name``, on the body in its T-pose."""
    start = (garment().rest.vertices - body().rest_joints()[0])[None].astype(np.float32)
    posed = source().pose(np.zeros((1, 24, 3)), np.zeros((1, body().shape_count)))
    assert posed.tensors.skin is not None
    settler = Settler(body())
    return start, settler.settle(settler.constants(garment(), fabric(name)), start, posed.tensors.skin.numpy())


def test_cloth_that_settles_has_less_energy_and_gives_as_its_fabric_does():
    lower = {}
    for name in ("sweat", "denim"):
        start, found = still(name)
        parts = [
            energies.total(torch.from_numpy(x), garment().cloth, Material.of(fabric(name))) for x in (start, found)
        ]
        before, after = (float(sum(part.values())) for part in parts)
        assert after < before
        lower[name] = float((start - found)[..., 1].mean())
    # A tube that nothing holds falls alike; what is left of it on the chest stretches.
    assert np.isfinite(list(lower.values())).all() and lower["sweat"] != pytest.approx(lower["denim"], rel=1e-3)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Trainer, Path]:
    """The trainer and the folder of its file; both are read by every test and changed by none."""
    trainer = Trainer(FABRIC_RUN, bank(), device=CPU)
    found = settled.settle_drapes(trainer, Settler(body()))
    assert found is not None
    folder = tmp_path_factory.mktemp("files")
    found.save(folder / "001_000000.npz")
    return trainer, folder


def test_files_keep_what_was_settled(made: tuple[Trainer, Path]):
    trainer, folder = made
    owner, found = SettledBank(folder).draw(trainer.wardrobe.garments, np.random.default_rng(0))
    assert owner is trainer.wardrobe.garments[0] and found.digest == settled_digest(owner)
    assert found.vertices.shape == (settled.FRAMES, len(owner.rest.vertices), 3)
    assert trainer.fabric is not None and found.fabric == trainer.fabric
    target = torch.from_numpy(found.vertices)
    assert float(distance(target, found, owner.cloth)) == 0.0
    assert_allclose(float(distance(target + 0.01, found, owner.cloth)), 3e-4, rtol=1e-3)


def test_the_command_writes_as_many_files_as_its_time_allows(tmp_path: Path, capsys):
    words = ["--model", str(exported()[1]), "--garment", "shorts", "--motions", str(MOTIONS_DIR)]
    assert settled.main([*words, "--minutes", "0.002", "--out", str(tmp_path / "new")]) == 0
    files = sorted((tmp_path / "new").iterdir())
    assert [path.name for path in files] == [f"001_{number:06d}.npz" for number in range(len(files))]
    assert f"{len(files)} files of {settled.FRAMES} drapes, 0 lost" in capsys.readouterr().out and files
    assert SettledDrapes.read(files[0]).garment == "shorts"


@pytest.mark.long
def test_drapes_without_corrections_go_toward_settled_ones(made: tuple[Trainer, Path]):
    weights, folder = made[0].model.state_dict(), made[1]
    config = replace(FABRIC_RUN, full_share=0.0, bare_share=1.0, learning_rate=2e-3, data=TINY_RUN.data)
    trainer = Trainer(config, bank(), device=CPU, weights=weights, settled=SettledBank(folder))
    found = [trainer.step()["settled_mm"] for _ in range(60)]
    assert np.mean(found[-5:]) < 0.9 * np.mean(found[:5])
    trainer.config = replace(config, full_share=1.0, bare_share=0.0)
    assert "settled_mm" not in trainer.step()


def test_folders_without_files_and_files_of_others_are_refused(made: tuple[Trainer, Path], tmp_path: Path):
    folder = Path(shutil.copytree(made[1], tmp_path / "files"))
    with pytest.raises(NotFound, match="settled drapes"):
        SettledBank(tmp_path)
    with pytest.raises(ArtifactError, match="of the garments of this run"):
        SettledBank(folder).draw([garment()], np.random.default_rng(0))
    (folder / "001_000000.npz").write_bytes(b"no archive")
    with pytest.raises(ArtifactError, match="001_000000"):
        SettledDrapes.read(folder / "001_000000.npz")
    with pytest.raises(InputError, match="--settled"):
        make_trainer(
            replace(FABRIC_RUN, model=replace(FABRIC_RUN.model, dynamic=True)),
            [],
            device=CPU,
            settled=SettledBank(folder),
        )


def test_without_a_folder_of_data_drapes_are_at_poses_of_the_shipped_clips(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(settled, "data_folder", lambda name: None)
    arguments = ["--model", "onefit", "--garment", "tshirt", "--minutes", "0", "--out", str(tmp_path / "settled")]
    assert settled.main(arguments) == 0
