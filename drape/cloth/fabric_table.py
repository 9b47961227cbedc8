"""Fabrics by name: ten measured by Wang, O'Brien and Ramamoorthi (2011), and four from laboratory readings.

Wang, O'Brien, Ramamoorthi, "Data-driven elastic models for cloth: modeling and measurement", ACM TOG 30(4).
Their fits give the stress per Green's strain in six rows, one at rest and five at a principal stretch of 1/6
along 0 to 90 degrees, and the bending coefficient k_e of hinges k_e l^2 theta^2 / (8 (A1 + A2)) for hinge edges
at 0, 45 and 90 degrees, each at five curvatures. Decision 0010 says why this is taken of it:

* axis 1 is the warp: it is the stiffer one of all ten at 1/6, as lengthwise is in knits;
* stretch a quarter of the way from rest to the mean of the five rows, which is 4 % of stretch; at rest itself the
  sweat's fit is not convex, and those of interlock and ponte narrow when pushed together;
* stretch and shear times 2, which the extensibility of such cloth asks for, and the equation of ``Fabric``
  counts shear once where a stress counts it twice: times 4;
* bending the mean over curvatures, k = k_e / 4, which makes the hinge that of ``bending``; an edge along axis 0
  bends along the warp.

Wang et al. measured neither thickness nor friction: those are estimates by the kind of cloth, as is damping.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import fields

from drape.cloth.fabric import Fabric
from drape.cloth.fabric_readings import FastReadings, KesReadings, from_fast, from_kes
from drape.errors import InputError, NotFound, did_you_mean

STRETCH_SHARE = 0.25  # how far from the fit at rest to that at a stretch of 1/6

# name: their cloth, kg/m2, stretch at rest (c11, c12, c22) and mean at 1/6, shear at rest [N/m],
# k_e of edges at 0, 45, 90 degrees [1e-6 J], our estimates of thickness [mm] and friction
_MEASURED = {
    "jersey": (
        *("gray interlock, T-shirt, 60 cotton 40 polyester", 0.187),
        *((16.59, -14.70, 34.48), (97.35, 81.18, 330.56), 36.86, (30.59, 18.75, 15.98), 0.8, 0.35),
    ),
    "rib": (
        *("ivory rib knit, underwear, 95 cotton 5 spandex", 0.276),
        *((42.87, -0.23, 65.17), (65.55, 1.29, 176.90), 83.18, (74.16, 29.13, 35.73), 1.1, 0.40),
    ),
    "ponte": (
        *("camel ponte roma, jacket, 60 polyester 40 rayon", 0.284),
        *((31.15, -12.80, 44.03), (109.53, 64.08, 191.26), 31.90, (39.96, 29.27, 29.92), 1.0, 0.35),
    ),
    "sweat": (
        *("navy sparkle sweat, sweater, 96 polyester 4 spandex", 0.224),
        *((12.49, -19.88, 3.27), (75.28, 71.02, 220.64), 17.62, (37.91, 29.33, 30.44), 1.0, 0.40),
    ),
    "stretch_denim": (
        *("11 oz black denim, jeans, 99 cotton 1 spandex", 0.324),
        *((205.35, 10.23, 1013.89), (226.88, 44.91, 1055.34), 53.39, (53.54, 59.68, 103.64), 0.7, 0.40),
    ),
    "twill": (
        *("royal target, trousers, 65 cotton 35 polyester", 0.220),
        *((2016.55, 9.17, 2034.98), (2109.66, 53.12, 2148.29), 104.76, (189.41, 133.28, 190.20), 0.45, 0.35),
    ),
    "jacket": (
        *("tango red jet set, light jacket, polyester", 0.113),
        *((43.07, 54.37, 171.42), (129.14, 90.65, 320.39), 14.31, (21.54, 18.90, 15.95), 0.3, 0.30),
    ),
    "table_cloth": (
        *("white dots on black, table cloth, polyester", 0.128),
        *((2002.09, 0.35, 2027.49), (2107.30, 50.82, 2146.02), 19.19, (44.51, 23.13, 25.58), 0.25, 0.25),
    ),
    "blanket": (
        *("pink ribbon brown, blanket, polyester", 0.228),
        *((151.50, 106.03, 244.83), (144.40, 95.56, 277.00), 30.25, (220.28, 83.27, 59.49), 1.5, 0.50),
    ),
    "swim": (
        *("white swim solid, swimsuit, 87 nylon 13 spandex", 0.204),
        *((47.97, 6.83, 104.62), (50.44, 16.06, 115.19), 60.77, (55.26, 50.13, 45.38), 0.6, 0.30),
    ),
}

# Bending of broadcloth as published; the other readings are estimates within the ranges of the comment.
_READINGS = {
    # B and 2HB: Matsudaira, Masuda, Wada, Yokura, J. Textile Eng. 61(6), 2015, table 1, cotton broad. Shirting
    # weighs 10 to 14 mg/cm2; its EMT is 3 to 10 %, its G 0.7 to 2.5.
    "poplin": KesReadings((4.0, 8.0), (0.7, 0.7), (0.118, 0.118), (0.124, 0.124), 1.2, 12.0, 0.35),
    # Between polyester faille (0.019, 0.007, ibid.) and heavier satin linings (0.06); G 0.25 to 0.6.
    "satin": KesReadings((3.0, 5.0), (0.7, 0.7), (0.034, 0.026), (0.012, 0.010), 0.35, 11.0, 0.25),
    # Chiffon and georgette: B 0.004 to 0.02, weight 4 to 8 mg/cm2, G 0.2 to 0.4.
    "chiffon": KesReadings((4.0, 6.0), (0.7, 0.7), (0.010, 0.008), (0.004, 0.003), 0.25, 6.0, 0.20),
}
# Rigid 12 oz denim, an estimate: bending length 25 to 35 mm, E20 0.3 to 1.5 %, EB5 0.8 to 3 %.
_DENIM = FastReadings((0.5, 1.2), 1.2, (31.0, 26.0), 407.0, 0.9)


def _measured(name: str) -> Fabric:
    cloth, density, rest, stretched, shear, bending, thickness_mm, friction = _MEASURED[name]
    c11, c12, c22 = (2.0 * (a + STRETCH_SHARE * (b - a)) for a, b in zip(rest, stretched, strict=True))
    warp_j, bias_j, weft_j = (0.25e-6 * k for k in bending)
    source = f"Wang, O'Brien, Ramamoorthi 2011: {cloth}; thickness, friction, damping estimated"
    return Fabric(
        *(name, c22, c11, c12, 4.0 * shear, warp_j, bias_j, weft_j, density, 1e-3 * thickness_mm, friction),
        source=source,
    )


_BROAD = "KES, bending of cotton broad by Matsudaira et al. 2015; the rest estimated"
FABRICS: dict[str, Fabric] = {
    **{name: _measured(name) for name in _MEASURED},
    **{
        name: from_kes(name, readings, source=_BROAD if name == "poplin" else "KES readings estimated by range")
        for name, readings in _READINGS.items()
    },
    "denim": from_fast("denim", _DENIM, source="FAST readings estimated by range"),
}
DEFAULT_FABRIC = "jersey"
# The names of ``material``, for one release: none of them was a fabric, so each is the nearest one.
ALIASES = {"soft": "jersey", "limp": "chiffon", "stiff": "denim", "crisp": "poplin"}


def fabric(which: str | Mapping[str, float] | Fabric) -> Fabric:
    """Returns the fabric called ``which``, the fabric with the numbers in the mapping ``which`` (fields of ``Fabric``),
    or ``which`` itself if it is a fabric.

    Raises ``NotFound`` for an unknown name and ``InputError`` for missing, unknown or unphysical numbers.
    """
    if isinstance(which, Fabric):
        return which
    if isinstance(which, str):
        if which in ALIASES:
            warnings.warn(f"fabric {which!r} is now {ALIASES[which]!r}", DeprecationWarning, stacklevel=2)
        name = ALIASES.get(which, which)
        if name not in FABRICS:
            cure = did_you_mean(name, FABRICS, "Use one of these names, or give numbers or laboratory readings.")
            raise NotFound("fabric", expected=f"one of {sorted(FABRICS)}", got=which, cure=cure)
        return FABRICS[name]
    try:
        return Fabric(**{"name": "given", **which})
    except TypeError as error:
        names = ", ".join(field.name for field in fields(Fabric))
        raise InputError(
            "fabric",
            expected=f"numbers for the fields {names} (those with a default may be left out)",
            got=f"{sorted(which)}: {error}",
            cure="Give the missing fields and drop the others.",
        ) from error
