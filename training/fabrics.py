"""Fabrics to train on: those of the table a little changed, and others whose quotients lie within its range."""

from __future__ import annotations

import numpy as np

from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import FABRICS
from drape.errors import InputError

STRETCH_N_PER_M = 43.1  # the stiffness of the cloth for which the losses' weights were chosen
TABLE_SHARE = 0.5
CHANGE = 0.15  # standard deviation of each logarithm of a fabric of the table
APART = 0.7  # fabrics with a smaller fabric_distance count as the one that is held out
COMPARED = ("warp_n_per_m", "weft_n_per_m", "shear_n_per_m", "bending_warp_j", "bending_weft_j")
TRIES = 1000


def stretch_share(fabric: Fabric) -> float:
    """Returns the stiffness of ``fabric`` against stretch, the geometric mean of warp and weft, over that of the cloth
    for which the losses' weights were chosen."""
    return float(np.sqrt(fabric.warp_n_per_m * fabric.weft_n_per_m)) / STRETCH_N_PER_M


class FabricBank:
    """The fabrics to train on, without those ``held_out`` and without any like these.

    Raises ``InputError`` for a name in ``held_out`` that ``FABRICS`` does not have.
    """

    def __init__(self, held_out: tuple[str, ...] = ()) -> None:
        unknown = sorted(set(held_out) - FABRICS.keys())
        if unknown:
            raise InputError(
                "held_out_fabrics", expected=f"of {sorted(FABRICS)}", got=unknown[0], cure="Name fabrics of the table."
            )
        self.held_out = [FABRICS[name] for name in held_out]
        self.known = [cloth for name, cloth in FABRICS.items() if name not in held_out]
        rows = np.array([_logarithms(cloth) for cloth in self.known])
        self._low, self._high = rows.min(axis=0), rows.max(axis=0)

    def draw(self, rng: np.random.Generator) -> Fabric:
        """Returns a random fabric that is not like one held out and whose energy is convex at rest: one of the table, a
        little changed, or one whose ``_logarithms`` are uniform over the table's range.

        Raises ``InputError`` where ``TRIES`` draws give none.
        """
        for _ in range(TRIES):
            if rng.random() < TABLE_SHARE:
                rows = _logarithms(self.known[int(rng.integers(len(self.known)))])
                rows = rows + CHANGE * rng.normal(size=rows.shape)
            else:
                rows = rng.uniform(self._low, self._high)
            try:
                cloth = _made_of(rows)
            except InputError:
                continue
            if not self.forbids(cloth):
                return cloth
        raise InputError(
            "held_out_fabrics",
            expected="fabrics that leave others to draw",
            got=f"none in {TRIES} draws",
            cure="Hold out fewer.",
        )

    def forbids(self, cloth: Fabric) -> bool:
        """Returns whether ``cloth`` is nearer than ``APART`` to a fabric that is held out."""
        return any(fabric_distance(cloth, other) < APART for other in self.held_out)


def fabric_distance(first: Fabric, second: Fabric) -> float:
    """Returns the norm of the differences of the logarithms of ``COMPARED``, the stiffnesses against stretch, shear and
    bending: 0 for fabrics that are alike."""
    return float(np.linalg.norm([np.log(getattr(first, name) / getattr(second, name)) for name in COMPARED]))


def _logarithms(cloth: Fabric) -> np.ndarray:
    """Logarithms (8,) of stretch, its warp over weft, shear over stretch, 1 + cross share, bending, its warp over weft,
    bias over both, density: within ranges of quotients a draw is likely to be a cloth."""
    stretch = np.sqrt(cloth.warp_n_per_m * cloth.weft_n_per_m)
    bending = np.sqrt(cloth.bending_warp_j * cloth.bending_weft_j)
    numbers = [
        stretch,
        cloth.warp_n_per_m / cloth.weft_n_per_m,
        cloth.shear_n_per_m / stretch,
        1.0 + cloth.cross_n_per_m / stretch,
        bending,
        cloth.bending_warp_j / cloth.bending_weft_j,
        cloth.bending_bias_j / bending,
        cloth.density_kg_m2,
    ]
    return np.log(numbers)


def _made_of(rows: np.ndarray) -> Fabric:
    """The fabric of these logarithms; raises ``InputError`` where it is none."""
    stretch, pull, shear, cross, bending, bend, bias, density = np.exp(rows)
    return Fabric(
        *("drawn", stretch * np.sqrt(pull), stretch / np.sqrt(pull), (cross - 1.0) * stretch, shear * stretch),
        *(bending * np.sqrt(bend), bending * bias, bending / np.sqrt(bend), density),
    )
