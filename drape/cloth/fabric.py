"""A fabric: what it weighs and how it resists stretch, shear and bending along warp, weft and bias.

Warp is lengthwise (the wale of a knit), weft crosswise (its course). The membrane is the orthotropic
St.Venant-Kirchhoff one of ``membrane``: with Green's strain G in warp and weft axes, per area [J/m^2]

    e = 1/2 (warp Gpp^2 + 2 cross Gpp Gtt + weft Gtt^2 + shear Gpt^2),  p the warp, t the weft

So ``shear`` is four times the shear modulus of a textile laboratory,
which divides the force per width by the shear angle 2 Gpt. Bending is a plate whose rigidity along a
direction at the angle a to the warp is ``plate_rigidity``; ``hinge_rigidity`` is that of the hinges which
make such a plate.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numpy as np

from drape.arrays import Array, namespace
from drape.errors import InputError

POSITIVE = (
    *("warp_n_per_m", "weft_n_per_m", "shear_n_per_m"),
    *("bending_warp_j", "bending_bias_j", "bending_weft_j", "density_kg_m2", "thickness_m"),
)


@dataclass(frozen=True)
class Fabric:
    """The constants of a fabric. Raises ``InputError`` for numbers that no fabric has, or whose energy is not convex at
    rest.

    ``warp_n_per_m``, ``weft_n_per_m``, ``cross_n_per_m`` and ``shear_n_per_m`` [N/m] are the stiffness of the membrane:
    with Green's strain G the energy per area is (warp Gpp^2 + 2 cross Gpp Gtt + weft Gtt^2 + shear Gpt^2) / 2.
    ``bending_*_j`` [J = N m] are plate rigidities against bending along warp, bias (45 degrees) and weft.
    ``density_kg_m2`` is mass per area, ``friction`` the coefficient against skin, ``damping_s`` [s] the ratio of
    damping to stiffness, and ``source`` says where the numbers come from.
    """

    name: str
    warp_n_per_m: float
    weft_n_per_m: float
    cross_n_per_m: float
    shear_n_per_m: float
    bending_warp_j: float
    bending_bias_j: float
    bending_weft_j: float
    density_kg_m2: float
    thickness_m: float = 5e-4
    friction: float = 0.35
    damping_s: float = 0.02
    source: str = "given as numbers"

    def __post_init__(self) -> None:
        for field in (*POSITIVE, "cross_n_per_m", "friction", "damping_s"):
            value = getattr(self, field)
            good = value > 0.0 if field in POSITIVE else field == "cross_n_per_m" or value >= 0.0
            if not (good and np.isfinite(value)):
                wanted = "a number > 0" if field in POSITIVE else "a finite number, friction and damping >= 0"
                raise InputError(
                    f"fabric {self.name}: {field}", expected=wanted, got=str(value), cure="Give a physical value."
                )
        limit = float(np.sqrt(self.warp_n_per_m * self.weft_n_per_m))
        if abs(self.cross_n_per_m) >= limit:
            raise InputError(
                f"fabric {self.name}: cross_n_per_m",
                expected=f"a size below sqrt(warp weft) = {limit:.4g} N/m, or some stretch would give energy back",
                got=f"{self.cross_n_per_m:.4g} N/m",
                cure=f"Take {0.1 * limit:.3g} N/m if it was not measured.",
            )
        least = float(hinge_rigidity(self, np.radians(np.arange(180.0))).min())
        if least < 0.0:
            mean = 0.5 * (self.bending_warp_j + self.bending_weft_j)
            raise InputError(
                f"fabric {self.name}: bending_bias_j",
                expected="rigidities along warp, bias and weft of which hinges of a positive one can be made",
                got=f"{self.bending_warp_j:.3g}, {self.bending_bias_j:.3g}, {self.bending_weft_j:.3g} J",
                cure=f"Take {0.8 * mean:.3g} J for the bias; warp and weft may differ by nine times.",
            )

    @cached_property
    def digest(self) -> str:
        """Sixteen hex digits, a hash of all that a drape can depend on: the numbers, neither name nor source."""
        numbers = {key: value for key, value in asdict(self).items() if key not in ("name", "source")}
        return hashlib.sha256(json.dumps(numbers, sort_keys=True).encode()).hexdigest()[:16]

    def softened(self, most_n_per_m: float) -> Fabric:
        """Returns the fabric with warp and weft of at most ``most_n_per_m`` [N/m] and cross in proportion; shear stays.

        Triangles that lie across the yarns cannot bend without stretching them, so on a mesh an inextensible cloth is
        stiffer than its rigidity (locking), the more the lighter it is. A membrane that its loads still do not stretch
        visibly has less of that.
        """
        warp, weft = min(self.warp_n_per_m, most_n_per_m), min(self.weft_n_per_m, most_n_per_m)
        share = float(np.sqrt(warp * weft / (self.warp_n_per_m * self.weft_n_per_m)))
        return replace(self, warp_n_per_m=warp, weft_n_per_m=weft, cross_n_per_m=share * self.cross_n_per_m)


def bending_angle(edge: Array) -> Array:
    """Returns the angle [rad] (H,) between the warp and the direction in which hinges bend, for rest edges ``edge`` (H,
    2) in the panel's axes (weft, warp).

    A hinge bends across its edge: an edge along the weft (x) lets the cloth bend along the warp (y). The edge's angle
    to the weft is therefore the direction's to the warp.
    """
    xp = namespace(edge)
    return xp.atan2(edge[..., 1], edge[..., 0])


def plate_rigidity(fabric: Fabric, angle_rad: Array) -> Array:
    """Returns the rigidity B [J] against bending along directions at ``angle_rad`` [rad] to the warp, with the shape of
    ``angle_rad``.

    B = a0 + a2 cos 2a + a4 cos 4a through the three given directions: that of every orthotropic plate, whose D11 cos^4
    + 2 (D12 + 2 D66) cos^2 sin^2 + D22 sin^4 it equals.
    """
    return _rigidity(_plate_harmonics(fabric), angle_rad)


def hinge_harmonics(fabric: Fabric) -> tuple[float, float, float]:
    """Returns (b, b2, b4) [J]: a hinge that bends at the angle a to the warp has the rigidity b + b2 cos 2a + b4 cos
    4a.

    On a cylinder along d a mesh of equilateral triangles bends each hinge by an angle proportional to 2 cos 2(a - d) +
    1, so that the plate feels the hinges around d with the square of that as weight: its harmonics of order 2 and 4
    arrive as 2/3 and 1/3. Hinges therefore get 3/2 and 3 times the plate's.
    """
    mean, second, fourth = _plate_harmonics(fabric)
    return mean, 1.5 * second, 3.0 * fourth


def hinge_rigidity(fabric: Fabric, angle_rad: Array) -> Array:
    """Returns the rigidity k [J] (H,) in ``drape.cloth.bending`` of hinges that bend at ``angle_rad`` [rad] (H,) to the
    warp."""
    return _rigidity(hinge_harmonics(fabric), angle_rad)


def _plate_harmonics(fabric: Fabric) -> tuple[float, float, float]:
    warp, bias, weft = fabric.bending_warp_j, fabric.bending_bias_j, fabric.bending_weft_j
    return 0.25 * (warp + weft + 2.0 * bias), 0.5 * (warp - weft), 0.25 * (warp + weft - 2.0 * bias)


def _rigidity(harmonics: tuple[float, float, float], angle_rad: Array) -> Array:
    xp = namespace(angle_rad)
    mean, second, fourth = harmonics
    return mean + second * xp.cos(2.0 * angle_rad) + fourth * xp.cos(4.0 * angle_rad)
