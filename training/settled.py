"""Targets for drapes without corrections: the network's own drape, settled by the solver of folds.

    python -m training.settled --model onefit --beside runs/sewn_garments --out runs/settled --minutes 40
    python -m training.run --finetune onefit --beside runs/sewn_garments --settled runs/settled --out runs/settled_model

Patches cannot fold. Cloth with too much length pushes them together, and that costs as much energy as stretching: a
smooth drape of least energy hangs the same in all fabrics. Cloth that may fold hangs by its weight and by how it
stretches. So the solver goes on until the cloth rests, free except where it lies on the skin, and the network learns
those places: in the mean of squares, their smooth part.

A file holds some poses of one garment in one fabric, drawn as those of a training step are.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from drape.arrays.subnormals import flushed
from drape.body.model import BodyModel
from drape.catalog import MOTIONS_DIR
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.cloth.material import Material
from drape.cloth.waistband import STIFFNESS_N_M2
from drape.contact.skin import body_skin
from drape.errors import refusing
from drape.files.data import data_folder
from drape.live.fold_constants import FoldConstants, WornCloth, leash_n_per_m
from drape.live.fold_step import FoldEffort, Frame, fold
from drape.live.skin_walks import nearest_at_rest, skin_graph
from training.batches import TrainingGarment
from training.poses import PoseBank, draw_betas, read_training_clips
from training.starting import finetune_from, with_more_garments
from training.targets import SettledDrapes, settled_digest
from training.trainer import Trainer

EFFORT = FoldEffort(steps=2, settle=40)
FRAMES = 6  # in a file: the constants of a garment in a fabric cost as much as one of them


class Settler:
    """The solver of folds over ``body``, with steps enough that a drape comes to rest."""

    def __init__(self, body: BodyModel) -> None:
        self._skin = body_skin(body)
        self._graph = skin_graph(self._skin)

    def constants(self, garment: TrainingGarment, fabric: Fabric) -> FoldConstants:
        """Returns the constants of folds for the training mesh of ``garment``, made of ``fabric``."""
        arrays = {
            item.name: value.numpy().astype(np.float64 if value.is_floating_point() else np.int64)
            for item in dataclasses.fields(ClothMesh)
            if isinstance(value := getattr(garment.cloth, item.name), Tensor)
        }
        cloth, index = replace(garment.cloth, **arrays), nearest_at_rest(garment.rest.vertices, self._skin)
        leash = leash_n_per_m(garment.rest.vertices, cloth.vertex_area, self._skin, index)
        if garment.band is not None:
            vertex, length_m = garment.band
            leash[vertex.numpy()] += STIFFNESS_N_M2 * length_m.numpy()
        return FoldConstants.of(WornCloth(cloth, Material.of(fabric), leash, self._graph, index))

    def settle(self, constants: FoldConstants, vertices: np.ndarray, skin: np.ndarray) -> np.ndarray:
        """Returns the drapes ``vertices`` [m] (F, V, 3) after they have come to rest over bodies with the posed samples
        ``skin`` (F, ..., 8), relative to the same origin: [m] (F, V, 3) float32, NaN for a drape that the solver lost.
        """
        frames = []
        for start, samples in zip(vertices, skin.reshape(len(skin), -1, skin.shape[-1]), strict=True):
            x, _, report = fold(constants, None, Frame(start, samples, 0.0), EFFORT)
            frames.append(np.full_like(start, np.nan) if report.reset else x)
        return np.stack(frames).astype(np.float32)


def settle_drapes(trainer: Trainer, settler: Settler) -> SettledDrapes | None:
    """Returns settled drapes of a garment, in a fabric and at ``FRAMES`` poses, all of which ``trainer`` draws; None if
    the solver lost one of them."""
    rng, config = trainer.rng, trainer.config
    trainer.draw_fabric()
    assert trainer.fabric is not None
    garment, partition = trainer.wardrobe.draw(rng)
    poses, betas = trainer.bank.draw(FRAMES, rng), draw_betas(FRAMES, trainer.body.shape_count, config.data, rng)
    with torch.no_grad():
        body = trainer.source.pose(poses, betas)
        start = trainer.drape(body, garment, partition, passes=0).vertices
    assert body.tensors.skin is not None
    constants = settler.constants(garment, trainer.fabric)
    vertices = settler.settle(constants, start.numpy(), body.tensors.skin.numpy())
    if not np.isfinite(vertices).all():
        return None
    return SettledDrapes(garment.name, settled_digest(garment), trainer.fabric, poses, betas, vertices)


@refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line: writes files of settled drapes into ``--out`` for ``--minutes``. Returns 0, or 2 after a
    refusal, whose sentence it prints."""
    parser = argparse.ArgumentParser(
        prog="python -m training.settled", description="Drapes of a model, let go on until they rest."
    )
    parser.add_argument("--model", type=Path, required=True, help="whose drapes, as of training.run --finetune")
    parser.add_argument("--garment", nargs="+", help="as of training.run")
    parser.add_argument("--beside", nargs="+", metavar="FILE", help="as of training.run")
    parser.add_argument("--motions", type=Path, nargs="*", help="folders of motion files; default DRAPE_DATA/motions")
    parser.add_argument("--minutes", type=float, default=40.0)
    parser.add_argument("--seed", type=int, default=1, help="another one makes other files")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    config, weights = finetune_from(options.model, options.garment)
    config = with_more_garments(config, options.beside)
    folders = options.motions or [folder for folder in [data_folder("motions")] if folder is not None] or [MOTIONS_DIR]
    bank = PoseBank(read_training_clips(folders, held_out=config.data.held_out), config.data)
    options.out.mkdir(parents=True, exist_ok=True)
    count, lost = 0, 0
    with flushed():
        trainer = Trainer(config, bank, device=torch.device("cpu"), weights=weights)
        trainer.rng = np.random.default_rng((options.seed, 77))  # garments stay those of the configuration
        settler, begun = Settler(trainer.body), time.monotonic()
        while time.monotonic() - begun < 60.0 * options.minutes:
            drapes = settle_drapes(trainer, settler)
            if drapes is None:
                lost += 1
                continue
            drapes.save(options.out / f"{options.seed:03d}_{count:06d}.npz")
            count += 1
    print(f"{count} files of {FRAMES} drapes, {lost} lost")
    return 0


if __name__ == "__main__":
    sys.exit(main())
