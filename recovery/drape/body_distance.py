"""The two representations of a body's signed distance, and the options that choose one on a command line."""

from __future__ import annotations

import argparse
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from recovery.sim.siren import DEFAULT_SIREN

SIREN_FOLDER = Path(".cache") / "siren"  # of the folder that a command is called in


class DistanceKind(StrEnum):
    """A grid, or the paper's network of sines."""

    GRID = "grid"
    SIREN = "siren"


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
    """The arguments of ``DrapeOptions`` that ``add_distance_options`` asked for."""
    return {
        "distance": given.distance,
        "siren": replace(DEFAULT_SIREN, steps=given.siren_steps),
        "siren_folder": given.siren_folder,
    }
