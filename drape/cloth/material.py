"""What a cloth is made of: stiffness, weight and its distance from the skin."""

from __future__ import annotations

from dataclasses import dataclass, replace

from drape.errors import InputError, NotFound


@dataclass(frozen=True)
class Material:
    """Constants of a cloth and of its contact with the body.

    ``mu_n_per_m``, ``lambda_n_per_m``: Lame constants of the St.Venant-Kirchhoff
    membrane times the thickness [N/m]. ``bending_j``: plate rigidity k of the
    hinges [J = N m]. ``density_kg_m2``: mass per area. ``contact_j_m4``: contact
    energy per area and squared depth [J/m^4], ``contact_gap_m``: distance from
    the skin at which it begins [m]. ``gravity_m_s2``: along -y.
    """

    mu_n_per_m: float = 11.1
    lambda_n_per_m: float = 20.9
    bending_j: float = 1.7e-4
    density_kg_m2: float = 0.2
    contact_j_m4: float = 3.0e5
    contact_gap_m: float = 0.004
    gravity_m_s2: float = 9.81

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            positive = name == "mu_n_per_m" or name == "density_kg_m2"
            if not (value > 0.0 if positive else value >= 0.0) or value == float("inf"):
                wanted = "a number > 0" if positive else "a number >= 0"
                raise InputError(f"material {name}", expected=wanted, got=str(value), cure="Give a physical value.")

    def scaled(self, stiffness: float) -> Material:
        """The same cloth with membrane and bending stiffness times ``stiffness``."""
        return replace(
            self,
            mu_n_per_m=self.mu_n_per_m * stiffness,
            lambda_n_per_m=self.lambda_n_per_m * stiffness,
            bending_j=self.bending_j * stiffness,
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


def material(name: str = DEFAULT_MATERIAL) -> Material:
    """The one of ``FABRICS`` called ``name``.

    "jersey" has the membrane constants 11.1 and 20.9 N/m of SNUG (Santesteban et
    al. 2022, Lame constants times 0.47 mm) and its 0.2 kg/m^2; "soft" and "stiff"
    are it with a third and three times the stiffness, "limp" and "crisp" with a fifth
    and five times that of bending alone. None of the four is a measured fabric.
    """
    if name not in FABRICS:
        raise NotFound("material", expected=f"one of {sorted(FABRICS)}", got=name, cure="Use one of these names.")
    return FABRICS[name]
