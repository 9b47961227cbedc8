"""The cut of a target: the base that it is nearest to, and sentences on what the base does not have.

Openings tell tops, trousers and skirts apart, places of openings tops with sleeves and without and tops and dresses.
A surface alone does not show its seams; a texture laid out as it was cut does.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drape.body.model import BodyModel
from drape.errors import InputError
from drape.garment.borders import borders, plainly_opening
from drape.garment.contours import TRUNK
from drape.garment.files.mesh import GarmentMesh
from drape.geometry import meshes
from recovery.pattern.bases import COUNT, MOST_PANELS
from recovery.pattern.measurements import BodyMeasurements, measure
from recovery.pattern.model import Pattern
from recovery.run.seen import Seen
from recovery.run.target import OF_TOPS, OPENINGS, describe_openings, opened
from recovery.run.upright import long_contours
from recovery.scan.collars import without_collar

SLEEVE_M = 0.06  # from the shoulder's joint to a cuff; an armhole lies within 3 cm of it
DRESS_M = 0.12  # below the crotch: no shirt's hem
COLLAR_M = 0.02  # that cloth stands above the edge of a neckline that is folded over
STANDS_M = 0.04  # above the neck's joint: no neckline lies there
COLLARS_M = (0.02, 0.12)  # widths that are drafted: what is narrower or wider is not a collar alone
KINDS = {2: "skirt", 3: "trousers", 4: "tshirt"}  # by the number of openings, where nothing more is known


@dataclass(frozen=True)
class Cut:
    """The cut that a recovery starts from: the ``base``, and whether the target ``told`` it, or the user named it.

    ``settings``: those that the base was drafted with. ``differs``: sentences on what of the target's cut the base does
    not have. ``collar_m`` [m]: the width of the target's collar, 0 for none.
    """

    base: str
    told: bool
    settings: dict[str, float]
    differs: tuple[str, ...]
    collar_m: float = 0.0

    @property
    def called(self) -> str:
        """The name of the base, or of its file."""
        return Path(self.base).name


def kind_of(mesh: GarmentMesh) -> str:
    """Returns the name of a base with as many openings as ``mesh`` has long borders, before its body and unit are
    known.

    If there are more than a top has, the borders that are not plainly openings count as holes.
    """
    count = len(long_contours(mesh))
    count = max(min(count, max(KINDS)), sum(map(plainly_opening, borders(mesh)[:count])))
    if count not in KINDS:
        raise InputError(
            "target",
            expected="two openings (a skirt), three (trousers) or four (a top)",
            got=f"{count}",
            cure="Name the base (--base), and open what is shut.",
        )
    return KINDS[count]


def told_base(seen: Seen, body: BodyMeasurements) -> str:
    """Returns the name of the base whose openings lie where those of the target do. Raises ``InputError`` if none
    does."""
    counts = seen.counts()
    fitting = [name for name, wanted in OPENINGS.items() if wanted == counts]
    top = seen.openings[TRUNK][0].centre[1] if fitting else 0.0
    round_trunk = "skirt" in fitting
    if not fitting or (round_trunk and top > 0.5 * (body.underarm_y + body.neck_y)):
        raise InputError(
            "target",
            expected="; ".join(dict.fromkeys(describe_openings(wanted) for wanted in OPENINGS.values())),
            got=(describe_openings(counts) or "no opening that the body goes through")
            + (", the upper one at the neck" if fitting else ""),
            cure="Open what is shut, or pass a pattern of the target's kind (--base FILE.json).",
        )
    if len(fitting) == 1:
        return fitting[0]
    hem = seen.openings[TRUNK][-1].centre[1]
    if round_trunk:
        return "skirt" if top <= _above(body) else "strapless_dress" if hem < body.crotch_y else "tube"
    reach = np.mean([one.along_m for part in ("left_arm", "right_arm") for one in seen.openings[part]])
    return (("tank", "dress"), ("tshirt", "sleeved_dress"))[int(reach > SLEEVE_M)][int(hem < body.crotch_y - DRESS_M)]


def _above(body: BodyMeasurements) -> float:
    """The height [m] beyond which a garment's upper opening is no waist."""
    return 0.5 * (body.waist_y + body.underarm_y)


def has_collar(mesh: GarmentMesh, seen: Seen, body: BodyMeasurements) -> bool:
    """Whether the cloth at the neck stands up, or is folded over so that its edge lies below its top."""
    neck = seen.openings[TRUNK][0]
    if neck.centre[1] > body.neck_y + STANDS_M:
        return True
    edge = neck.contour.points
    radius = np.linalg.norm((edge - neck.contour.centre)[:, [0, 2]], axis=1).max()
    near = np.linalg.norm((mesh.vertices - neck.contour.centre)[:, [0, 2]], axis=1) < radius
    return bool(mesh.vertices[near, 1].max() > edge[:, 1].max() + COLLAR_M)


def collarless(
    mesh: GarmentMesh, wearer: BodyModel, joints: np.ndarray, there: dict[str, int]
) -> tuple[GarmentMesh, tuple[str, ...], float]:
    """``mesh``, whose openings are ``there``, without its collar, a sentence on it, and its width [m]; 0 for none.

    ``joints`` [m] (24, 3) are those of ``wearer`` in the target's pose. A collar stays where openings would change. Its
    width, stand and fall together, is its area over the length of the neckline that is left.
    """
    if there != OF_TOPS:
        return mesh, (), 0.0
    seen = Seen(mesh.vertices, mesh.faces, joints, wearer.joints_template)
    if not has_collar(mesh, seen, measure(wearer)):
        return mesh, (), 0.0
    bare, gone = without_collar(mesh, joints)
    bare, after = opened(bare, joints, there)
    if after != there:
        return mesh, ("The target has a collar, which no base has: the neckline is drawn to its edge",), 0.0
    words = f"The target has a collar, which no base has: it was cut off at the neck, {gone:.0%} of the cloth"
    neck = Seen(bare.vertices, bare.faces, joints, wearer.joints_template).openings[TRUNK][0].contour
    width = gone * float(meshes.face_areas(mesh.vertices, mesh.faces).sum()) / neck.length_m
    if not COLLARS_M[0] <= width <= COLLARS_M[1]:
        return bare, (f"{words}; the pattern ends at the neckline",), 0.0
    return bare, (f"{words}, about {100 * width:.0f} cm wide",), width


def panel_count(base: str, shown: int | None) -> dict[str, float]:
    """Returns the setting ``panels`` of a skirt whose texture has ``shown`` so many gores; empty for another base, or
    if it is the base's own number."""
    return {COUNT: float(shown)} if base == "skirt" and shown is not None and 2 < shown <= MOST_PANELS else {}


def ring_panels(pattern: Pattern) -> list[str]:
    """Names of panels that are sewn to themselves to a ring, as bands and one-piece sleeves; darts are none."""
    panels = []
    for stitch in pattern.stitches:
        panel, apart = stitch.first.panel, abs(stitch.first.edge - stitch.second.edge)
        if panel == stitch.second.panel and 1 < apart < len(pattern.panel(panel).edges) - 1:
            panels.append(panel)
    return panels


def differences(base: str, pattern: Pattern, seen: Seen, body: BodyMeasurements, shown: int | None) -> tuple[str, ...]:
    """Sentences on how the cut of a target that lies on ``body`` differs from ``pattern``, drafted from ``base``.

    ``shown`` is the number of panels that its texture shows, None for none.
    """
    sentences = []
    if base in OPENINGS:
        nearest = told_base(seen, body)
        if nearest != base:
            sentences.append(f"The target looks like a {nearest.replace('_', ' ')}: its base is --base {nearest}")
    elif rings := ring_panels(pattern):
        sentences.append(
            f"Of the base {', '.join(rings)} begin flat and are closed to a ring: they may close beside waist or arm; "
            "take a base without them, and --style"
        )
    panels = len(pattern.panels)
    if shown is None:
        sentences.append("The target does not show its seams: panels and seams are the base's")
    elif shown != panels:
        sentences.append(
            f"The target's texture is laid out in {shown} panels, this pattern has {panels}: seams lie elsewhere"
        )
    return tuple(sentences)
