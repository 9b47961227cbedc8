"""The constants of the cloth as unknowns of a search (equation 9 of Yu, Cordier and Seo 2024), and fabrics by name.

A drape at rest without friction only knows stiffness over weight, so the density is given and never sought.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from drape.cloth.material import FABRICS, MEASURED, OrthotropicMaterial
from drape.errors import InputError
from recovery.drape.pipeline import HANGS_LONGER, hanging

LOG_M = 0.01  # [m] of unknown per unit of a logarithm: a stiffness times e weighs as much as control points moved 1 cm
NAMES = ("stretch across", "stretch along", "shear", "coupling", "bending")
SAME = 0.05  # of a factor: nearer to 1 it is not worth a word


class ClothTensors(NamedTuple):
    """``stretch`` [N/m] (4,) = (H00, H01, H11, H22) and ``bending_j`` [J] ()."""

    stretch: Tensor
    bending_j: Tensor


def logarithms(cloth: OrthotropicMaterial) -> np.ndarray:
    """(ln H00, ln H11, ln H22, logit of H01 / sqrt(H00 H11), ln k) (5,): any five numbers are a cloth.

    Raises ``InputError`` for a cloth without coupling or bending, which has none.
    """
    if cloth.h01 <= 0.0 or cloth.bending_j <= 0.0:
        raise InputError(
            "cloth to be freed",
            expected="h01 > 0 and bending > 0",
            got=f"h01 {cloth.h01:g} N/m, bending {cloth.bending_j:g} J",
            cure="Begin with small positive ones.",
        )
    share = cloth.h01 / np.sqrt(cloth.h00 * cloth.h11)
    positive = np.array([cloth.h00, cloth.h11, cloth.h22, share / (1.0 - share), cloth.bending_j])
    return np.log(positive)


def from_logarithms(numbers: Tensor) -> ClothTensors:
    """The constants of ``logarithms`` (5,); differentiable."""
    h00, h11, h22, k = (torch.exp(numbers[i]) for i in (0, 1, 2, 4))
    h01 = torch.sigmoid(numbers[3]) * torch.sqrt(h00 * h11)
    return ClothTensors(torch.stack([h00, h01, h11, h22]), k)


class FreeCloth:
    """A cloth as a function of five ``values`` [m] (5,), zero for ``origin``."""

    count = len(NAMES)

    def __init__(self, origin: OrthotropicMaterial) -> None:
        self.origin = origin
        self.logarithms = logarithms(origin)
        known = np.array([logarithms(named(name)) for name in FABRICS])
        self.range = (torch.from_numpy(known.min(axis=0)), torch.from_numpy(known.max(axis=0)))

    def tensors(self, values: Tensor) -> ClothTensors:
        """The constants at ``values``; differentiable."""
        return from_logarithms(torch.from_numpy(self.logarithms) + values / LOG_M)

    def implausible(self, values: Tensor) -> Tensor:
        """L_mat of equation 6 [m^2] (): squared distance to the range that the named fabrics span, zero inside."""
        numbers = torch.from_numpy(self.logarithms) + values / LOG_M
        low, high = self.range
        off = torch.clamp(low - numbers, min=0.0) + torch.clamp(numbers - high, min=0.0)
        return LOG_M**2 * (off * off).sum()

    def values_of(self, cloth: OrthotropicMaterial) -> np.ndarray:
        """The values (5,) at which it is ``cloth``, weight aside."""
        return LOG_M * (logarithms(cloth) - self.logarithms)

    def cloth(self, values: np.ndarray) -> OrthotropicMaterial:
        """The cloth at ``values``, with the density of ``origin``."""
        stretch, bending = self.tensors(torch.from_numpy(np.asarray(values, dtype=np.float64)))
        h00, h01, h11, h22 = stretch.tolist()
        return replace(self.origin, h00=h00, h01=h01, h11=h11, h22=h22, bending_j=float(bending))

    def slopes(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives (4, 5) of the stretch and (5,) of the bending by the values."""
        at = torch.from_numpy(np.asarray(values, dtype=np.float64))
        stretch, bending = torch.autograd.functional.jacobian(lambda v: tuple(self.tensors(v)), at)
        return stretch.numpy(), bending.numpy()


def named(name: str, longer: float = HANGS_LONGER) -> OrthotropicMaterial:
    """The fabric called ``name`` as it is draped (``hanging``). Raises ``NotFound``."""
    return hanging(name, longer)


class Fabric(NamedTuple):
    """The named fabric nearest to a cloth; ``factors`` (5,): the cloth's stiffnesses over its own, as in ``NAMES``.

    Stiffnesses are those over the weight; that of the coupling is a ratio of odds, see ``logarithms``.
    """

    name: str
    factors: np.ndarray

    def describe(self) -> str:
        """Such as "jersey, but bending 1.40 times as stiff"."""
        told = [
            f"{what} {factor:.2f} times as stiff"
            for what, factor in zip(NAMES, self.factors, strict=True)
            if abs(np.log(factor)) > SAME
        ]
        return (
            f"{self.name}, but {', '.join(told)}" if told else f"{self.name}, within {100 * SAME:.0f} % in everything"
        )


def bolt_name(name: str, cloth: OrthotropicMaterial) -> str:
    """The fabric called ``name`` as a pattern's label has it: name and weight, of which a cutter knows the bolt."""
    return f"{name} {1e3 * cloth.density_kg_m2:.0f} g/m²"


def nearest_fabric(cloth: OrthotropicMaterial, longer: float = HANGS_LONGER) -> Fabric:
    """The fabric ``named`` whose logarithms are nearest to those of ``cloth``, stiffness over weight."""

    def over_weight(one: OrthotropicMaterial) -> np.ndarray:
        numbers = logarithms(one)
        numbers[[0, 1, 2, 4]] -= np.log(one.density_kg_m2)
        return numbers

    off = {name: over_weight(cloth) - over_weight(named(name, longer)) for name in (*FABRICS, *MEASURED)}
    name = min(off, key=lambda one: float((off[one] ** 2).sum()))
    return Fabric(name, np.exp(off[name]))
