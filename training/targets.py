"""Settled drapes as files: ``training.settled`` makes them, a trainer learns from them."""

from __future__ import annotations

import dataclasses
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.errors import ArtifactError, InputError, NotFound
from drape.files.atomic import whole_file
from training.batches import TrainingGarment

TRIES = 64


@dataclass(frozen=True, eq=False)
class SettledDrapes:
    """F settled drapes of one training garment, named ``garment``, made of ``fabric``: ``vertices`` [m] (F, V, 3)
    relative to the root joint, at ``poses`` (F, 24, 3) [rad] of bodies of shapes ``betas`` (F, S). ``digest`` is the
    ``settled_digest`` of the garment."""

    garment: str
    digest: int
    fabric: Fabric
    poses: np.ndarray
    betas: np.ndarray
    vertices: np.ndarray

    def save(self, path: Path) -> None:
        """Writes the drapes as the file ``path``, whole or not at all."""
        header = {"garment": self.garment, "digest": self.digest, "fabric": dataclasses.asdict(self.fabric)}
        with whole_file(path) as file:
            np.savez(file, said=json.dumps(header), poses=self.poses, betas=self.betas, vertices=self.vertices)

    @classmethod
    def read(cls, path: Path) -> SettledDrapes:
        """Returns the drapes in the file ``path``. Raises ``ArtifactError`` where ``save`` did not write it."""
        try:
            with np.load(path, allow_pickle=False) as stored:
                header = json.loads(str(stored["said"]))
                arrays = {name: stored[name] for name in ("poses", "betas", "vertices")}
                return cls(header["garment"], header["digest"], Fabric(**header["fabric"]), **arrays)
        except (OSError, ValueError, KeyError, TypeError, InputError) as error:
            raise ArtifactError(
                f"settled drapes {path.name}",
                expected="a file of python -m training.settled",
                got=str(error)[:200],
                cure="Delete it, or make the folder anew.",
            ) from error


def settled_digest(garment: TrainingGarment) -> int:
    """Returns a checksum (CRC-32) of the garment's vertices and faces at rest. It tells whether settled drapes are of
    that mesh."""
    rest = np.ascontiguousarray(garment.rest.vertices.astype(np.float32))
    return zlib.crc32(garment.rest.faces.astype(np.int64).tobytes(), zlib.crc32(rest.tobytes()))


class SettledBank:
    """The settled drapes in the files of ``folder``, to which files may be added while training runs.

    Raises ``NotFound`` where it has none.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        if not self._files():
            raise NotFound(
                "settled drapes",
                expected="files made by python -m training.settled",
                got=f"none in {folder.name}",
                cure="Make some first.",
            )

    def _files(self) -> list[Path]:
        return sorted(self.folder.glob("*.npz"))

    def draw(
        self, garments: Sequence[TrainingGarment], rng: np.random.Generator
    ) -> tuple[TrainingGarment, SettledDrapes]:
        """Returns one of ``garments``, and its settled drapes from a random file. A file is of a garment that has the
        same name and mesh (``settled_digest``).

        Raises ``ArtifactError`` where ``TRIES`` random files are of none of ``garments``. In a parallel run every
        process draws neighbours of designs of its own, and files hold those of process 0 alone.
        """
        files, known = self._files(), {(garment.name, settled_digest(garment)): garment for garment in garments}
        for _ in range(TRIES):
            drapes = SettledDrapes.read(files[int(rng.integers(len(files)))])
            if (garment := known.get((drapes.garment, drapes.digest))) is not None:
                return garment, drapes
        raise ArtifactError(
            "settled drapes",
            expected="of the garments of this run, cut by the same seed",
            got=drapes.garment,
            cure="Make them with the same --model, --beside and --garment.",
        )


def distance(vertices: Tensor, settled: SettledDrapes, cloth: ClothMesh) -> Tensor:
    """Returns the mean squared distance [m^2] () of ``vertices`` [m] (F, V, 3) to those of ``settled``, weighted by the
    area of the ``cloth`` at rest."""
    target = torch.from_numpy(settled.vertices).to(vertices)
    area = cloth.vertex_area / cloth.vertex_area.sum()
    return ((vertices - target).square().sum(dim=-1) @ area).mean()
