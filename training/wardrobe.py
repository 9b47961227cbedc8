"""The garments trained on: named designs, random neighbours of them, and partitions drawn afresh as it goes on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from drape.body.model import BodyModel
from drape.catalog import open_garment
from drape.cloth import rest_state
from drape.cloth.energies import ClothMesh
from drape.cloth.rest_state import RestState
from drape.cloth.waistband import waistband
from drape.contact.skin import body_skin
from drape.errors import InputError
from drape.garment.fabric_features import warp_directions
from drape.garment.fitting import RestGarment, rest_garment
from drape.geometry import meshes
from training.batches import Partition, TrainingGarment, draw_partition
from training.config import DataConfig
from training.garment_design import DESIGNS, build_design, vary_design


class Wardrobe:
    """The garments of a run with their partitions: designs and variants of them, or garment files after intake.

    With ``fabrics`` hinges are flat at rest and some variants are cut with another grain. Without, for networks that
    know no fabric, cloth rests as it is modelled. ``process`` gives every process of a parallel run variants of its
    own. Raises ``InputError`` for a garment that is no design and no file.

    A garment's partition into patches is known by its random seed, so that a checkpoint holds seeds and ``restore``
    draws the same partitions again.
    """

    def __init__(
        self,
        config: DataConfig,
        body: BodyModel,
        *,
        seed: int,
        device: torch.device,
        process: int = 0,
        fabrics: bool = True,
    ) -> None:
        self.config, self.device, self._skin = config, device, body_skin(body)
        self._body, self._fabrics = body, fabrics
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(process,)))
        self.garments: list[TrainingGarment] = []
        self.own: list[int] = []  # places of the named designs themselves
        for name in config.garments:
            for label, vertices, faces, own in self._meshes(name, body, rng):
                if label == name:
                    self.own.append(len(self.garments))
                rest = rest_garment(vertices, faces, body)
                count = config.partitions if label == name else config.variant_partitions
                seeds = [int(rng.integers(2**31)) for _ in range(count)]
                self.garments.append(
                    self._training_garment(label, rest, seeds, self._cloth(rest, own, rng, turned=label != name))
                )

    def _meshes(
        self, name: str, body: BodyModel, rng: np.random.Generator
    ) -> Iterator[tuple[str, np.ndarray, np.ndarray, RestState | None]]:
        """Label, vertices and faces of a garment and its neighbours, and how its cloth rests where it says so."""
        if Path(name).is_file():
            garment = open_garment(Path(name), body)
            yield name, garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64), garment.rest_state()
            return
        if name not in DESIGNS:
            raise InputError(
                "garment",
                expected=f"one of {sorted(DESIGNS)}, or a garment file",
                got=name,
                cure="Name a known design or a file that is there.",
            )
        yield (name, *build_design(DESIGNS[name], body), None)
        for i in range(self.config.variants):
            yield (f"{name}_{i}", *vary_design(DESIGNS[name], body, rng)[1:], None)

    def _cloth(
        self, rest: RestGarment, own: RestState | None, rng: np.random.Generator, *, turned: bool
    ) -> tuple[RestState, np.ndarray]:
        """The rest state of the cloth, and its warp (F, 3): the garment's own if it has one, else vertical.

        A ``turned`` garment may be cut with another grain, by chance.
        """
        if not self._fabrics:
            return rest_state.modelled_rest(rest.vertices, rest.faces), rest_state.grain_along(
                rest.vertices, rest.faces
            )
        if own is not None:
            return own, warp_directions(own, rest.vertices, rest.faces)
        warp = rest_state.grain_along(rest.vertices, rest.faces)
        if turned and rng.random() < self.config.bias_share:
            angle = rng.uniform(0.0, np.pi)
            across = np.cross(meshes.face_normals(rest.vertices, rest.faces), warp)
            warp = np.cos(angle) * warp + np.sin(angle) * across
        return rest_state.flat_rest(rest.vertices, rest.faces, warp), warp

    def _training_garment(
        self, label: str, rest: RestGarment, seeds: list[int], state_and_warp: tuple[RestState, np.ndarray]
    ) -> TrainingGarment:
        state, warp = state_and_warp
        cloth = ClothMesh.of(state, rest.faces, len(rest.vertices)).like(torch.zeros(1, device=self.device))
        weights = torch.from_numpy(rest.binding.weights.astype(np.float32)).to(self.device)
        waist = waistband(rest.vertices, rest.faces, self._body)
        band = None
        if waist is not None:
            length = torch.from_numpy(waist.length_m.astype(np.float32))
            band = torch.from_numpy(waist.vertex).to(self.device), length.to(self.device)
        partitions = [self._partition(rest, seed, warp) for seed in seeds]
        return TrainingGarment(label, rest, cloth, partitions, weights, seeds, warp, band)

    def _partition(self, rest: RestGarment, seed: int, warp: np.ndarray) -> Partition:
        span = self.config.patch_range
        return draw_partition(rest, self._skin, seed=seed, span=span, device=self.device, warp=warp)

    def draw(self, rng: np.random.Generator) -> tuple[TrainingGarment, Partition]:
        """Returns a random garment and one of its partitions. With chance ``own_share`` it is a named design or a file,
        else any garment."""
        own = rng.random() < self.config.own_share
        place = self.own[int(rng.integers(len(self.own)))] if own else int(rng.integers(len(self.garments)))
        garment = self.garments[place]
        return garment, garment.partitions[int(rng.integers(len(garment.partitions)))]

    def refresh(self, rng: np.random.Generator) -> None:
        """Replaces a random partition of a random garment by one that is drawn anew."""
        garment = self.garments[int(rng.integers(len(self.garments)))]
        self._replace(garment, int(rng.integers(len(garment.partitions))), int(rng.integers(2**31)))

    def _replace(self, garment: TrainingGarment, place: int, seed: int) -> None:
        garment.partitions[place] = self._partition(garment.rest, seed, garment.warp)
        garment.seeds[place] = seed

    def seeds(self) -> list[list[int]]:
        """Returns the random seeds of the partitions of each garment, for ``restore``."""
        return [list(garment.seeds) for garment in self.garments]

    def restore(self, seeds: list[list[int]]) -> None:
        """Replaces the partitions whose random seeds differ from ``seeds`` by those that ``seeds`` draw."""
        for garment, wanted in zip(self.garments, seeds, strict=True):
            for place, seed in enumerate(wanted):
                if garment.seeds[place] != seed:
                    self._replace(garment, place, seed)
