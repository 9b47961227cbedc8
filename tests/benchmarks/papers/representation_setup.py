"""A small real bench for the representations: the tube round the trunk, spine bent, on the shipped body."""

from __future__ import annotations

from functools import cache

import numpy as np

from benchmarks.papers.representation import Bench
from benchmarks.papers.representation_space import Charts, charts, repartitioned
from drape.body.assets import load_body
from drape.cloth.material import material
from drape.garment.cache import Garment
from tests.fixtures.garments import tube_garment

PATCHES = 14


def bent(count: int = 2) -> np.ndarray:
    """Poses (count, 24, 3) [rad]: the spine more and more forward and to the side."""
    poses = np.zeros((count, 24, 3))
    poses[:, (3, 6), 0] = np.linspace(0.2, 0.4, count)[:, None]
    poses[:, 6, 2] = np.linspace(0.1, 0.3, count)
    return poses


@cache
def bench() -> Bench:
    body = load_body()
    return Bench.of(tube_garment(body), body, bent(), material())


@cache
def garment() -> Garment:
    """The tube in ``PATCHES`` patches, fitted as intake fits them."""
    return repartitioned(bench().judge.cloth.garment, bench().rest, PATCHES)


@cache
def found() -> Charts:
    return charts(garment(), bench().judge.cloth.mesh, bench().judge.cloth.material)
