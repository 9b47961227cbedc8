"""Which signed distance a body is given to contact by: the grid, or the network of the paper."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from recovery.sim.sdf import GridDistance, SignedDistance
from recovery.sim.siren import DEFAULT_SIREN, SirenOptions, stored_siren

SIREN_FOLDER = Path(".cache") / "siren"  # of the folder that a command is called in


class DistanceKind(StrEnum):
    """How a body's signed distance is represented."""

    GRID = "grid"
    SIREN = "siren"


def skin_distance(
    vertices: np.ndarray,
    faces: np.ndarray,
    kind: DistanceKind,
    *,
    grid_m: float,
    siren: SirenOptions = DEFAULT_SIREN,
    folder: Path = SIREN_FOLDER,
    report: Callable[[str], None] | None = None,
) -> SignedDistance:
    """The signed distance of a closed surface, ``vertices`` [m] (V, 3) and ``faces`` (F, 3).

    A grid of spacing ``grid_m`` is made anew. A network is read from ``folder``; if it is not there, it is trained as
    ``siren`` says, which takes minutes, and written there. Raises ``MeshError`` for an open surface and
    ``ArtifactError`` for a damaged file.
    """
    if kind is DistanceKind.SIREN:
        return stored_siren(vertices, faces, folder, siren, report=report)
    return GridDistance.from_mesh(vertices, faces, spacing_m=grid_m)


def add_distance_options(parser: argparse.ArgumentParser) -> None:
    """Adds ``--distance``, ``--siren-steps`` and ``--siren-folder`` to a command."""
    parser.add_argument(
        "--distance",
        type=DistanceKind,
        choices=list(DistanceKind),
        default=DistanceKind.GRID,
        help="of the body: a grid, or the paper's network of sines, trained for minutes on every new body or pose",
    )
    parser.add_argument("--siren-steps", type=int, default=DEFAULT_SIREN.steps, help="of the network's training")
    parser.add_argument("--siren-folder", type=Path, default=SIREN_FOLDER, help="where trained networks are kept")


def distance_options(given: argparse.Namespace) -> dict[str, Any]:
    """What ``add_distance_options`` added, as arguments of ``DrapeOptions``."""
    return {
        "distance": given.distance,
        "siren": replace(DEFAULT_SIREN, steps=given.siren_steps),
        "siren_folder": given.siren_folder,
    }
