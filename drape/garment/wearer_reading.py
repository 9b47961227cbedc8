"""How a garment's file may be meant, and the body that is found in it, with its words."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.garment.mesh_checks import UNITS_M
from drape.garment.registration import unpack_parameters
from drape.garment.wearer_fields import SHAPES

# Costs of readings that few write. Files turned round are not so few; of 31 garments 27 fit worse by 0.02 or more.
ODD = {"inch": 0.02, "free": 0.12, "x up": 0.02, "downward": 0.1, "sideways": 0.05, "backward": 0.02}
FREE_WORSE = 0.03  # a size between the units must fit better by this
AXES = ("+y", "-y", "+z", "-z", "+x", "-x")
USUAL_FRONTS = {"+y": ("+z",), "+z": ("-y", "+x"), "+x": ("+y", "+z", "-z")}


@dataclass(frozen=True)
class Reading:
    """One way to read the coordinates of a file: their ``unit`` ("cm", ..., or "free" for a size between the units) and
    its length ``scale`` [m], and the axes ``up`` and ``front`` of the body, such as "+y"."""

    unit: str
    scale: float
    up: str
    front: str

    @cached_property
    def turn(self) -> np.ndarray:
        """Returns the rotation R (3, 3) from the file's axes to y up, facing +z: x = R x_file."""
        up, front = _axis(self.up), _axis(self.front)
        return np.stack([np.cross(up, front), up, front])

    @cached_property
    def oddness(self) -> float:
        """Returns a cost without unit: 0 for units and axes that programs usually write, up to 0.27 for those that few
        write."""
        odd = ODD.get(self.unit, 0.0) + (ODD["x up"] if self.up == "+x" else 0.0)
        odd += ODD["downward"] if self.up not in USUAL_FRONTS else 0.0
        fronts = USUAL_FRONTS.get(self.up, ())
        backward = self.turned_round.front in fronts
        return odd + (0.0 if self.front in fronts else ODD["backward" if backward else "sideways"])

    @property
    def turned_round(self) -> Reading:
        """The same reading with the body turned round: its front is the back of this one's."""
        return replace(self, front=("-" if self.front[0] == "+" else "+") + self.front[1])

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Returns ``points`` (N, 3) of the file in metres, y up, facing +z; the origin stays."""
        return self.scale * (points @ self.turn.T)


def _axis(name: str) -> np.ndarray:
    return (1.0 if name[0] == "+" else -1.0) * np.eye(3)["xyz".index(name[1])]


@dataclass(frozen=True, eq=False)
class WearerCandidate:
    """A body that may have worn a garment, in the frame that ``reading`` gives: metres, y up, facing +z.

    ``parameters`` (P,) are those that ``unpack_parameters`` takes. ``energy`` ranks bodies, without unit; it is 0 for
    cloth that lies on the skin all round. ``inside`` in [0, 1] is the share of the cloth deeper than 1 cm in the skin,
    and ``open_share`` in [0, 1] the share of the directions around its bones that is bare. ``band_m`` is the median
    distance of the cloth's upper end from the skin. Of accessories and jewellery both ``energy`` and ``band_m`` are the
    distance [m] of the whole thing from the skin. ``sleeved`` says whether the cloth shows the pose of the arms, and
    ``fault`` what does not fit, "" if all does. ``odd_arms`` is the cost of arms in a pose that few have. ``origin``:
    the file's origin is at the body's "root" or "floor", or elsewhere (""). ``sure``, in [0, 1], is low where another
    reading, or the same body higher or lower, fits nearly as well. ``others`` are bodies that are nearly as likely.

    ``among`` ranks the bodies of one reading. It is the energy without cloth that hangs away from the skin, since
    larger bodies are nearer to that, plus what an uneven upper end and cloth in the skin cost. ``slid_m``: how far the
    skin under the cloth is from that of another body of the same reading that fits as well; the largest of such
    distances, 0 if there is none.
    """

    reading: Reading
    body: BodyModel
    parameters: np.ndarray
    energy: float
    inside: float
    open_share: float
    band_m: float
    sleeved: bool
    fault: str = ""
    odd_arms: float = 0.0
    origin: str = ""
    sure: float = 1.0
    others: tuple[WearerCandidate, ...] = ()
    among: float = 0.0
    slid_m: float = 0.0

    @property
    def rank(self) -> float:
        """Returns the number by which candidates of different readings are compared; the least is the best. Cloth that
        hangs far away counts half: a train does not make a hood of a gown."""
        return 0.5 * (self.energy + self.among) + (FREE_WORSE if self.reading.unit == "free" else 0.0)

    @property
    def betas(self) -> np.ndarray:
        return unpack_parameters(self.body, self.parameters)[0]

    @property
    def pose(self) -> np.ndarray:
        return unpack_parameters(self.body, self.parameters)[1]

    @property
    def trans(self) -> np.ndarray:
        return unpack_parameters(self.body, self.parameters)[2]

    @cached_property
    def height_m(self) -> float:
        """Returns the body's height [m], in the rest pose."""
        return float(np.ptp(self.body.rest_vertices(self.betas)[:, 1]))

    @cached_property
    def arms_deg(self) -> float:
        """Returns how far [deg] the upper arms point below the horizontal, the mean of both."""
        joints = self.body.posed_joints(self.pose[None], self.betas)[0]
        return float(np.mean([_drop_deg(joints, side) for side in ("left", "right")]))

    @property
    def words(self) -> str:
        """Returns the body in words, such as "a woman of 1.68 m, arms 40 degrees down, decimetres"."""
        far = {name: float(np.linalg.norm(self.betas[:10] - SHAPES[name])) for name in ("man", "woman")}
        who = "a person" if abs(far["man"] - far["woman"]) < 0.8 else f"a {min(far, key=lambda name: far[name])}"
        names = {"m": "metres", "cm": "centimetres", "dm": "decimetres", "mm": "millimetres", "inch": "inches"}
        scale = self.reading.scale
        size = f"{scale:.3g} m" if scale > 1.0 else f"{100.0 * scale:.3g} cm"
        unit = names.get(self.reading.unit, f"units of {size}")
        arms = f"arms {self.arms_deg:.0f} degrees down" if self.sleeved else "arms not shown"
        axes = "" if self.reading.up == "+y" else f", {self.reading.up.lstrip('+')} up"
        return f"{who} of {self.height_m:.2f} m, {arms}, {unit}{axes}"

    @property
    def axes(self) -> dict[str, str | float]:
        """Returns the reading as an avatar states it: "unit", a name or a number of metres, "up" and "facing"."""
        unit = self.reading.unit if self.reading.unit in UNITS_M else float(f"{self.reading.scale:.6g}")
        return {"unit": unit, "up": self.reading.up.lstrip("+"), "facing": self.reading.front.lstrip("+")}

    @property
    def doubts(self) -> list[str]:
        """Returns a sentence for each of the ``others``: what the garment may be instead, and which avatar to state for
        that."""
        sentences = []
        for other in self.others:
            backward = other.reading == self.reading.turned_round
            seems = "it may be worn back to front" if backward else f"it may be for {other.words}{other.unlike(self)}"
            how = "its wearer's others have the avatar of that"
            if other.reading != self.reading:
                how = f"the avatar {json.dumps(other.axes)} takes it so"
            sentences.append(f"{seems}: {how}")
        return sentences

    @property
    def options(self) -> dict[str, str]:
        """Returns the form field of an upload that chooses this body: "avatar", the JSON text of ``axes``, "betas",
        "pose" [rad] and "trans" [m]."""
        arrays = {"betas": self.betas, "pose": self.pose.reshape(-1), "trans": self.trans}
        numbers = {name: np.round(array, 4).tolist() for name, array in arrays.items()}
        return {"avatar": json.dumps(self.axes | numbers, separators=(",", ":"))}

    def to_json(self) -> dict[str, Any]:
        """Returns the candidate for JSON, as the garment's manifest holds it: "height_m", "arms_deg", "sure", "words"
        and "options" like the fields and properties of these names; "unit", "up" and "facing", the reading; and
        "others", a list of the same for each of the ``others``."""
        others = [one._facts() | {"words": one.words + one.unlike(self)} for one in self.others]
        return self._facts() | {"others": others}

    def unlike(self, other: WearerCandidate) -> str:
        """Returns words for how this body differs from ``other`` if their ``words`` are alike, such as ", the cloth 9
        cm lower"; "" if it does not differ."""
        if (self.reading.up, self.reading.front) != (other.reading.up, other.reading.front):
            return f", facing {self.reading.front.lstrip('+')}"
        rise_cm = round(100.0 * float(self.trans[1] - other.trans[1]))
        if self.reading != other.reading or not rise_cm:
            return ""
        return f", the cloth {abs(rise_cm)} cm {'lower' if rise_cm > 0 else 'higher'}"

    def _facts(self) -> dict[str, Any]:
        return {
            "height_m": round(self.height_m, 3),
            "unit": self.reading.unit if self.reading.unit in UNITS_M else f"{self.reading.scale:.4g} m",
            "up": self.reading.up.lstrip("+"),
            "facing": self.reading.front.lstrip("+"),
            "arms_deg": round(self.arms_deg, 1),
            "sure": round(self.sure, 2),
            "words": self.words,
            "options": self.options,
        }


def _drop_deg(joints: np.ndarray, side: str) -> float:
    way = joints[JOINT_NAMES.index(f"{side}_elbow")] - joints[JOINT_NAMES.index(f"{side}_shoulder")]
    return float(np.degrees(np.arctan2(-way[1], np.hypot(way[0], way[2]))))


def readings_of(units: Iterable[tuple[str, float]], up: str | None, front: str | None) -> Iterable[Reading]:
    """Yields the readings with each of ``units`` (names and lengths [m]) and each pair of axes; the axes ``up`` and
    ``front`` are fixed if they are not None."""
    ups, fronts = (list(AXES) if one is None else [one] for one in (up, front))
    for (unit, scale), upward, forward in product(units, ups, fronts):
        if upward[1] != forward[1]:
            yield Reading(unit, scale, upward, forward)
