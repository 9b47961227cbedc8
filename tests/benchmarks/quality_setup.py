"""A small real bench: the tube garment, and a small network of random weights, exported as a model is."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.cases import CaseClip
from benchmarks.measure.jitter import Window
from benchmarks.model_drape import ModelDrape
from benchmarks.quality import Bench
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.cloth.material import material
from drape.garment.cache import Garment
from drape.garment.fitting import patch_fields, rest_garment
from drape.motion.hard_poses import HardPoses
from tests.fixtures.garments import tube_garment
from tests.fixtures.packed import exported

SPINE = (3, 6)


@cache
def body() -> BodyModel:
    return load_body()


@cache
def tube() -> Garment:
    """The tube, in patches as intake fits them."""
    garment = tube_garment(body())
    rest = rest_garment(garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64), body())
    return replace(garment, **patch_fields(rest, count=14))


@cache
def network() -> ModelDrape:
    return ModelDrape(exported()[1], body(), threads=1)


def bending(count: int, angle_rad: float = 0.7) -> np.ndarray:
    """Poses (count, 24, 3) whose spine bends forward to ``angle_rad``, fastest in the middle."""
    poses = np.zeros((count, 24, 3))
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, count))
    poses[:, SPINE, 0] = angle_rad * share[:, None]
    return poses


def bench(cache_folder: Path, *, step_limit: int = 60) -> Bench:
    """Two poses, one window of twelve frames, a physics run just long enough to come to rest."""
    return Bench(
        clip=CaseClip.hard(HardPoses(bending(3)[1:], ("bend:1", "bend:2")), body()),
        network=network(),
        material=material(),
        step_limit=step_limit,
        windows=[Window(bending(12), "bend:0-11")],
        physics_folder=cache_folder,
    )
