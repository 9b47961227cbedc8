"""The constants of a cloth that its energies take: those of its fabric, and of its contact with the body."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from drape.arrays import Array
from drape.cloth import fabric_table
from drape.cloth.fabric import Fabric, hinge_harmonics
from drape.errors import InputError, NotFound

POSITIVE = ("warp_n_per_m", "weft_n_per_m", "shear_n_per_m", "density_kg_m2")
SIGNED = ("cross_n_per_m", "bending_2_j", "bending_4_j")


@dataclass(frozen=True)
class OrthotropicMaterial:
    """The constants of a cloth in panel axes, x along the weft and y along the warp: stiffness ``h00`` .. ``h22``
    [N/m], plate rigidity ``bending_j`` [J], and mass per area. Raises ``InputError`` where some strain would meet no
    resistance, for a rigidity below 0, for a mass that is not above 0, and for numbers that are not finite.

    The stress is s00 = h00 e00 + h01 e11, s11 = h01 e00 + h11 e11, s01 = h22 e01 with Green's strain e. An isotropic
    cloth has h00 = h11 = lambda + 2 mu, h01 = lambda, h22 = 2 mu.
    """

    h00: float
    h01: float
    h11: float
    h22: float
    bending_j: float
    density_kg_m2: float

    def __post_init__(self) -> None:
        numbers = np.array(list(vars(self).values()), dtype=np.float64)
        stiff = self.h00 > 0.0 and self.h11 > 0.0 and self.h22 > 0.0 and self.h01**2 < self.h00 * self.h11
        if not (np.isfinite(numbers).all() and stiff and self.bending_j >= 0.0 and self.density_kg_m2 > 0.0):
            raise InputError(
                "orthotropic material",
                expected="h00, h11, h22, density > 0, h01^2 < h00 h11, bending >= 0",
                got=str(self),
                cure="Give a stiffness that resists every strain.",
            )

    @property
    def stretch_n_per_m(self) -> np.ndarray:
        """The stiffness (h00, h01, h11, h22) [N/m] (4,)."""
        return np.array([self.h00, self.h01, self.h11, self.h22])


@dataclass(frozen=True)
class Material:
    """The constants of a cloth and of its contact with the body; numbers, or arrays (..., 1) with a number for each
    cloth.

    ``warp_n_per_m`` .. ``shear_n_per_m``: the orthotropic St.Venant-Kirchhoff membrane of ``Fabric`` [N/m].
    ``bending_j``, ``bending_2_j``, ``bending_4_j`` [J = N m]: b, b2 and b4 of the rigidity b + b2 cos 2a + b4 cos 4a of
    hinges that bend at the angle a to the warp (``fabric.hinge_harmonics``). ``density_kg_m2``: mass per area.
    ``contact_j_m4``: contact energy per area and squared depth [J/m^4], ``contact_gap_m``: distance from the skin at
    which it begins [m]. ``gravity_m_s2``: along -y. Raises ``InputError`` for numbers that are not physical.

    The default is isotropic, with the Lame constants 11.1 and 20.9 N/m of SNUG (Santesteban et al. 2022, times 0.47 mm)
    and its 0.2 kg/m^2: the cloth that every figure before real fabrics was measured with.
    """

    warp_n_per_m: float | Array = 2.0 * 11.1 + 20.9
    weft_n_per_m: float | Array = 2.0 * 11.1 + 20.9
    cross_n_per_m: float | Array = 20.9
    shear_n_per_m: float | Array = 4.0 * 11.1
    bending_j: float | Array = 1.7e-4
    bending_2_j: float | Array = 0.0
    bending_4_j: float | Array = 0.0
    density_kg_m2: float | Array = 0.2
    contact_j_m4: float = 3.0e5
    contact_gap_m: float = 0.004
    gravity_m_s2: float = 9.81

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not isinstance(value, float | int):
                continue  # an array: each of its fabrics was checked before
            good = value > 0.0 if name in POSITIVE else name in SIGNED or value >= 0.0
            if not (good and np.isfinite(value)):
                wanted = "a number > 0" if name in POSITIVE else "a finite number, >= 0 where it has no sign"
                raise InputError(f"material {name}", expected=wanted, got=str(value), cure="Give a physical value.")

    @classmethod
    def of(cls, fabric: Fabric) -> Material:
        """Returns the constants of a cloth made of ``fabric``, its contact and gravity the default ones."""
        membrane = (fabric.warp_n_per_m, fabric.weft_n_per_m, fabric.cross_n_per_m, fabric.shear_n_per_m)
        return cls(*membrane, *hinge_harmonics(fabric), fabric.density_kg_m2)

    @property
    def membrane(self) -> tuple[float | Array, ...]:
        """The membrane's stiffness (warp, weft, cross, shear) [N/m]."""
        return self.warp_n_per_m, self.weft_n_per_m, self.cross_n_per_m, self.shear_n_per_m

    @property
    def bending(self) -> tuple[float | Array, ...]:
        """The coefficients (b, b2, b4) [J] of the hinges' rigidity, as in ``fabric.hinge_harmonics``."""
        return self.bending_j, self.bending_2_j, self.bending_4_j

    def scaled(self, stiffness: float) -> Material:
        """Returns the material with membrane and bending stiffness times ``stiffness``."""
        stiff = (*self.membrane, *self.bending)
        names = [field.name for field in fields(self)][: len(stiff)]
        return replace(self, **{name: stiffness * value for name, value in zip(names, stiff, strict=True)})

    @property
    def woven(self) -> OrthotropicMaterial:
        """The same cloth in panel axes, as ``recovery.sim`` takes it; its one rigidity is ``bending_j``."""
        half = 0.5 * self.shear_n_per_m
        return OrthotropicMaterial(
            self.weft_n_per_m, self.cross_n_per_m, self.warp_n_per_m, half, self.bending_j, self.density_kg_m2
        )


DEFAULT_MATERIAL = "jersey"
_JERSEY = Material()
FABRICS = {
    DEFAULT_MATERIAL: _JERSEY,
    "soft": _JERSEY.scaled(1.0 / 3.0),
    "stiff": _JERSEY.scaled(3.0),
    "limp": replace(_JERSEY, bending_j=_JERSEY.bending_j / 5.0),
    "crisp": replace(_JERSEY, bending_j=_JERSEY.bending_j * 5.0),
}
# The fabrics of the table. The knit of its jersey is an interlock, which is its name beside the jersey above.
MEASURED = {
    ("interlock" if name == DEFAULT_MATERIAL else name): Material.of(fabric)
    for name, fabric in fabric_table.FABRICS.items()
}


def worn_fabric(name: str) -> str:
    """Returns the name, in the table of fabrics, of what a garment of ``material(name)`` is worn in: itself, or that
    which is nearest to one of the five."""
    listed = {name: name for name in MEASURED} | fabric_table.ALIASES | {"interlock": DEFAULT_MATERIAL}
    return listed.get(name, DEFAULT_MATERIAL)


def material(name: str = DEFAULT_MATERIAL) -> Material:
    """Returns the material called ``name``, of ``FABRICS`` or ``MEASURED``. Raises ``NotFound`` for other names.

    "jersey" has the membrane constants 11.1 and 20.9 N/m of SNUG (Santesteban et al. 2022, Lame constants times 0.47
    mm) and its 0.2 kg/m^2; "soft" and "stiff" are it with a third and three times the stiffness, "limp" and "crisp"
    with a fifth and five times that of bending alone. None of the five is a measured fabric; those of ``MEASURED``
    are.
    """
    known = {**FABRICS, **MEASURED}
    if name not in known:
        raise NotFound("material", expected=f"one of {sorted(known)}", got=name, cure="Use one of these names.")
    return known[name]
