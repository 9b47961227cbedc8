"""A small real bench: the tube garment, and a model that leaves it where its rigid patches put it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.network import Network
from benchmarks.quality_jitter import Window
from benchmarks.quality_measures import Bench
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.cloth.contact import BodyContact
from drape.cloth.material import material
from drape.garment.cache import Garment
from drape.motion.hard_poses import HardPoses
from tests.fixtures.tiny_model import tube_garment, write_tiny_model

SPINE = (3, 6)


@cache
def body() -> BodyModel:
    return load_body()


@cache
def tube() -> Garment:
    """The tube, its patch features zero, so that the tiny model does not lift its patches."""
    garment = tube_garment(body())
    return replace(garment, patch_features=np.zeros_like(garment.patch_features))


def network(folder: Path) -> Network:
    return Network(write_tiny_model(folder, body()), body(), threads=1)


def bending(count: int, angle_rad: float = 0.7) -> np.ndarray:
    """Poses (count, 24, 3) whose spine bends forward to ``angle_rad``, fastest in the middle."""
    poses = np.zeros((count, 24, 3))
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, count))
    poses[:, SPINE, 0] = angle_rad * share[:, None]
    return poses


def bench(folder: Path, *, step_limit: int = 60, cache_folder: Path | None = None) -> Bench:
    """Two poses, one window of twelve frames, a physics run just long enough to come to rest."""
    poses = bending(3)[1:]
    contact = BodyContact(body().faces, body().vertex_count)
    skin = body().posed_vertices(poses)
    return Bench(
        body=body(),
        poses=HardPoses(poses, ("bend:1", "bend:2")),
        contact=contact,
        body_vertices=skin,
        body_normals=np.asarray(contact.normals(skin)),
        network=network(folder),
        material=material(),
        step_limit=step_limit,
        windows=[Window(bending(12), "bend:0-11")],
        physics_folder=cache_folder,
    )
