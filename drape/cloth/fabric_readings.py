"""Fabrics from the readings of textile laboratories: Kawabata's KES-FB and CSIRO's FAST, in their own units.

What neither measures is estimated: the cross stiffness as 0.1 sqrt(warp weft), rigidity on the bias as 0.8 of
the mean of warp and weft (Wang et al. 2011: 0.5 to 1.0 over ten fabrics, mean 0.8).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.cloth.fabric import Fabric
from drape.errors import InputError

GF_PER_CM_N_PER_M = 0.980665  # gram-force per centimetre
KES_LOAD_N_PER_M = 500.0 * GF_PER_CM_N_PER_M
# The load at which stretch is read off a curve: a garment carries 1 to 100 N/m. Woven cloth is several times stiffer at
# the 490 N/m where KES ends, because by then its crimp is gone.
GARMENT_LOAD_N_PER_M = 20.0 * GF_PER_CM_N_PER_M
KES_BENDING_J = 9.80665e-5  # gf cm^2 / cm
KES_HYSTERESIS_N = 9.80665e-3  # gf cm / cm
GRAVITY_M_S2 = 9.80665
# Curvature [1/m] at which a draped cloth bends: of cantilevers and of the nodes of a drape test, radius 3 cm.
DRAPE_CURVATURE = 30.0
CROSS_SHARE, BIAS_SHARE = 0.1, 0.8


@dataclass(frozen=True)
class KesReadings:
    """One fabric's readings by the instruments KES-FB1 to FB4; pairs are (warp, weft).

    ``extension_pct`` EMT [%] at 500 gf/cm, ``linearity`` LT, ``bending`` B [gf cm^2/cm], ``hysteresis`` 2HB [gf cm/cm],
    ``shear`` G [gf/(cm deg)], ``weight`` W [mg/cm^2], ``thickness_mm`` T0 at 0.5 gf/cm^2.
    """

    extension_pct: tuple[float, float]
    linearity: tuple[float, float]
    bending: tuple[float, float]
    hysteresis: tuple[float, float]
    shear: float
    weight: float
    thickness_mm: float


@dataclass(frozen=True)
class FastReadings:
    """One fabric's readings by the instruments FAST-1 to FAST-3; pairs are (warp, weft).

    ``extension_pct`` E20 [%] at 20 gf/cm, ``bias_extension_pct`` EB5 [%] at 5 gf/cm, ``bending_length_mm`` c of FAST-2
    [mm], ``weight`` W [g/m^2], ``thickness_mm`` T2 at 2 gf/cm^2.
    """

    extension_pct: tuple[float, float]
    bias_extension_pct: float
    bending_length_mm: tuple[float, float]
    weight: float
    thickness_mm: float


def from_kes(name: str, readings: KesReadings, *, source: str = "KES readings") -> Fabric:
    """Returns the fabric called ``name`` that has these ``readings``. Raises ``InputError`` for a reading out of range.

    Stretch: EMT and LT fix the curve F = A e^n, n = 2 / LT - 1, which is read off at 20 gf/cm. Shear: k = 4 G. Bending:
    the secant of the loop's rising branch, B + HB / curvature, at the curvature of a drape, since an elastic cloth has
    no friction that would carry HB.
    """
    _check(name, readings)
    stretch = [
        _stiffness(e * (GARMENT_LOAD_N_PER_M / KES_LOAD_N_PER_M) ** (linearity / (2.0 - linearity)))
        for e, linearity in zip(np.array(readings.extension_pct) / 100.0, readings.linearity, strict=True)
    ]
    bending = [
        KES_BENDING_J * b + 0.5 * KES_HYSTERESIS_N * loop / DRAPE_CURVATURE
        for b, loop in zip(readings.bending, readings.hysteresis, strict=True)
    ]
    modulus = readings.shear * GF_PER_CM_N_PER_M * 180.0 / np.pi
    return _fabric(name, stretch, 4.0 * modulus, bending, 0.01 * readings.weight, readings.thickness_mm, source)


def from_fast(name: str, readings: FastReadings, *, source: str = "FAST readings") -> Fabric:
    """Returns the fabric called ``name`` that has these ``readings``. Raises ``InputError`` for a reading out of range.

    Stretch: the extension at 20 gf/cm. Shear: FAST's own G = 123 / EB5 [N/m], k = 4 G. Bending: FAST's own B = w
    c^3.
    """
    _check(name, readings)
    stretch = [_stiffness(e) for e in np.array(readings.extension_pct) / 100.0]
    density = 1e-3 * readings.weight
    bending = [density * GRAVITY_M_S2 * (1e-3 * c) ** 3 for c in readings.bending_length_mm]
    modulus = 123.0 / readings.bias_extension_pct
    return _fabric(name, stretch, 4.0 * modulus, bending, density, readings.thickness_mm, source)


def _stiffness(extension: float) -> float:
    """k [N/m] of F = k l (l^2 - 1) / 2, l = 1 + ``extension`` at ``GARMENT_LOAD_N_PER_M``."""
    return 2.0 * GARMENT_LOAD_N_PER_M / (extension * (extension + 1.0) * (extension + 2.0))


def _fabric(
    name: str,
    stretch: list[float],
    shear: float,
    bending: list[float],
    density: float,
    thickness_mm: float,
    source: str,
) -> Fabric:
    return Fabric(
        name=name,
        warp_n_per_m=float(stretch[0]),
        weft_n_per_m=float(stretch[1]),
        cross_n_per_m=float(CROSS_SHARE * np.sqrt(stretch[0] * stretch[1])),
        shear_n_per_m=float(shear),
        bending_warp_j=float(bending[0]),
        bending_bias_j=float(BIAS_SHARE * 0.5 * (bending[0] + bending[1])),
        bending_weft_j=float(bending[1]),
        density_kg_m2=float(density),
        thickness_m=1e-3 * thickness_mm,
        source=source,
    )


def _check(name: str, readings: KesReadings | FastReadings) -> None:
    for field, value in vars(readings).items():
        numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
        least, most = (
            (0.0 if field == "hysteresis" else np.nextafter(0.0, 1.0)),
            (2.0 if field == "linearity" else np.inf),
        )
        if not ((numbers >= least).all() and (numbers < most).all()):
            raise InputError(
                f"fabric {name}: {field}",
                expected="a reading > 0" + (", below 2" if field == "linearity" else ""),
                got=str(value),
                cure="Give what the instrument showed, in its own unit (docs/reference/fabrics.md).",
            )
