"""Packers of a few garments, and bodies for them."""

from __future__ import annotations

import numpy as np
import pytest

from drape.body.assets import load_body
from drape.graph.packing import pack_body
from drape.inference.engine import Engine
from drape.inference.onnx_runtime import Device
from drape.inference.packing import Packer
from tests.fixtures.packed import KINDS, exported, garment
from tests.fixtures.poses import random_motion

BODIES = 64


@pytest.fixture(scope="module")
def bodies() -> dict[str, np.ndarray]:
    """Sixty-four clients, each with its own pose and shape."""
    body = load_body()
    poses, _ = random_motion(BODIES, seed=4)
    poses[0] = 0.0
    shapes = np.random.default_rng(1).normal(size=(BODIES, body.shape_count))
    rows = [pack_body(body, shapes[i]).rows(poses[i : i + 1]) for i in range(BODIES)]
    return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}


def make_packer(threads: int = 1, *, compiled: bool = False, **options: int) -> Packer:
    """A packer of ``KINDS``."""
    return packer_of(Engine(exported()[1], device=Device(threads=threads), compiled=compiled), **options)


def packer_of(engine: Engine, **options: int) -> Packer:
    """A packer of ``KINDS`` on ``engine``."""
    packer = Packer(engine, load_body(), **options)
    for kind in KINDS:
        packer.add(kind, garment(kind))
    return packer
