"""What a target shows of its cut, and the base that it is nearest to; sentences on what the base does not have.

Openings tell tops, trousers and skirts apart, places of openings tops with sleeves and without and tops and dresses.
Places are told along the bones and then counted on the body in its T-pose, where bases are drafted. A surface alone
does not show its seams; a texture laid out as it was cut does.

No base has a collar, so one is cut off where the neck begins. It stands round the neck and may be folded over. Near the
neck, what lies above the neckline of a plain shirt is cut off: that is highest at the sides and lowest in front. What
then lies loose on the shoulders is the collar's fall.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.errors import InputError
from drape.garment.contours import TRUNK, Contour, bone_chains, open_contours, place_of
from drape.garment.files.mesh import GarmentMesh
from drape.garment.sheets import main_sheet, with_used_vertices
from drape.geometry import mesh_graphs, meshes
from drape.geometry.sections import closed_rings, level_section
from recovery.pattern.bases import COUNT, MOST_PANELS
from recovery.pattern.measurements import BodyMeasurements, measure_body
from recovery.pattern.sewing_pattern import Pattern
from recovery.run.target import OF_TOPS, OPENINGS, close_but_openings, describe_openings

EVEN_STRETCH = 1.25  # over the median: triangles of a panel that is laid out as it was cut are stretched by less
LAID_OUT = 0.9  # share of the cloth whose triangles are so in a layout of panels
LEAST_PIECE = 1e-3  # a panel of a texture has at least this share of all faces
SLEEVE_M = 0.06  # a cuff is farther than this from the shoulder's joint; an armhole lies within 3 cm of it
DRESS_M = 0.12  # a hem farther below the crotch is no shirt's
COLLAR_M = 0.02  # cloth of a collar stands this far above the edge of a neckline that is folded over
STANDS_M = 0.04  # no neckline lies as far above the neck's joint
COLLARS_M = (0.02, 0.12)  # widths that are drafted: what is narrower or wider is not a collar alone
NECK_RADIUS_M = 0.13  # no collar's fold lies farther from the neck's axis
AHEAD, BEHIND = 0.6, 0.2  # how far a neckline falls from the sides of the neck, per metre forward and backward
RISE_M = 0.01  # height of the neckline at the sides above the neck's joint: cloth lies off the skin


@dataclass(frozen=True, eq=False)
class BodyOpening:
    """An opening of a garment: its ``contour`` where the target is, and on the wearer in the T-pose its ``points`` [m]
    (n, 3) and their ``centre`` [m] (3,).

    ``along_m`` [m] is its place along the bones of its part of the body: from the shoulder or hip of a limb, from the
    pelvis of the trunk.
    """

    contour: Contour
    points: np.ndarray
    centre: np.ndarray
    along_m: float


class SeenGarment:
    """A target as far as it shows its cut: ``vertices`` [m] (V, 3) and ``faces`` (F, 3) on a wearer whose ``joints``
    [m] (24, 3) are known in its pose, and at ``rest`` [m] (24, 3) in the T-pose.

    ``openings`` has the openings of each part of the body that has any, by its name; those of the trunk from above.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, rest: np.ndarray) -> None:
        self._vertices, self._faces = vertices, faces
        self._chains, self._rest = bone_chains(joints), bone_chains(rest)
        at = dict(zip(JOINT_NAMES, joints, strict=True))
        self.openings: dict[str, list[BodyOpening]] = {}
        for contour in open_contours(vertices, faces):
            place = place_of(contour, self._chains)
            if place.part is None:
                continue
            here, there = (self._point(chains, place.part, place.along_m) for chains in (self._chains, self._rest))
            root = 0.0
            if place.part.endswith("arm"):
                side = place.part.split("_")[0]
                root = float(np.linalg.norm(at[f"{side}_shoulder"] - at[f"{side}_collar"]))
            centre = contour.centre - here + there
            opening = BodyOpening(contour, contour.points - here + there, centre, place.along_m - root)
            self.openings.setdefault(place.part, []).append(opening)
        self.openings.get(TRUNK, []).sort(key=lambda opening: -opening.along_m)

    def counts(self) -> dict[str, int]:
        """Returns how many openings each part of the body has, by its name."""
        return {part: len(openings) for part, openings in self.openings.items()}

    def girth(self, part: str, rest_axis: int, value_m: float) -> float | None:
        """Returns the length [m] of the cloth round ``part``, across its bones, at the place where these cross the
        plane x_axis = ``value_m`` [m] in the T-pose.

        None where they do not, or no cloth goes round them. ``rest_axis`` is the number of the axis.
        """
        chain, below = self._rest[part]
        along = _where(chain, rest_axis, value_m)
        if along is None:
            return None
        point = self._point(self._chains, part, along - below)
        ahead = self._point(self._chains, part, along - below + 0.01)
        return girth_round(self._vertices, self._faces, point, ahead - point)

    def _point(self, chains: dict[str, tuple[np.ndarray, float]], part: str, along_m: float) -> np.ndarray:
        """The point (3,) of a part's bones ``along_m`` from its root."""
        chain, below = chains[part]
        lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(chain, axis=0), axis=1))])
        return np.array([np.interp(along_m + below, lengths, column) for column in chain.T])


def _where(chain: np.ndarray, axis: int, value: float) -> float | None:
    """How far along the line ``chain`` (n, 3) its coordinate first is ``value``."""
    run = 0.0
    for start, end in pairwise(chain):
        length, rise = float(np.linalg.norm(end - start)), float(end[axis] - start[axis])
        share = (value - float(start[axis])) / rise if rise else -1.0
        if 0.0 <= share <= 1.0:
            return run + share * length
        run += length
    return None


def girth_round(vertices: np.ndarray, faces: np.ndarray, point: np.ndarray, normal: np.ndarray) -> float | None:
    """Returns the length [m] of the longest closed loop round ``point`` [m] (3,) in which the plane through it with
    this ``normal`` (3,), of any length, cuts the mesh.

    A loop goes round a point that its convex hull holds. None where no loop does.
    """
    right, ahead = np.linalg.svd(normal[None])[2][1:]
    level = (vertices - point) @ np.stack([right, normal / np.linalg.norm(normal), ahead]).T
    rings = closed_rings(level_section(faces, level, 0.0), level)
    return max((ring.length_m for ring in rings if (ring.hull.equations[:, -1] < 0.0).all()), default=None)


def pieces(mesh: GarmentMesh) -> int | None:
    """Returns the number of panels that the texture of ``mesh`` shows; None where it is no layout of panels.

    It is one if it shows the cloth as it is cut: triangles have, but for one scale, the sizes that they have in space.
    """
    if not len(mesh.uv_faces):
        return None
    corner = mesh.uv[mesh.uv_faces]
    ways = corner[:, 1:] - corner[:, :1]
    flat = 0.5 * np.abs(ways[:, 0, 0] * ways[:, 1, 1] - ways[:, 0, 1] * ways[:, 1, 0])
    area = meshes.face_areas(mesh.vertices, mesh.faces)
    if not (flat > 0.0).all():
        return None
    ratio = np.sqrt(area / flat)
    ratio /= np.median(ratio)
    if float(area[(ratio < EVEN_STRETCH) & (ratio > 1.0 / EVEN_STRETCH)].sum() / area.sum()) < LAID_OUT:
        return None
    piece = mesh_graphs.connected_components(mesh.uv_faces, len(mesh.uv))[mesh.uv_faces[:, 0]]
    return int((np.bincount(piece) > LEAST_PIECE * len(mesh.faces)).sum())


@dataclass(frozen=True)
class Cut:
    """The cut that a recovery starts from: the name or file of the ``base``, and whether the target's openings chose it
    (``by_openings``) or the user named it.

    ``settings``: the values by name that the base was drafted with. ``differs``: sentences on what of the target's cut
    the base does not have. ``collar_m`` [m]: the width of the target's collar, 0 for none.
    """

    base: str
    by_openings: bool
    settings: dict[str, float]
    differs: tuple[str, ...]
    collar_m: float = 0.0

    @property
    def called(self) -> str:
        """The name of the base, or that of its file."""
        return Path(self.base).name


def tell_base(seen: SeenGarment, body: BodyMeasurements) -> str:
    """Returns the name of the base whose openings lie where those of the target do. Raises ``InputError`` if those of
    none do."""
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
    reach = np.mean([cuff.along_m for part in ("left_arm", "right_arm") for cuff in seen.openings[part]])
    return (("tank", "dress"), ("tshirt", "sleeved_dress"))[int(reach > SLEEVE_M)][int(hem < body.crotch_y - DRESS_M)]


def _above(body: BodyMeasurements) -> float:
    """The height [m] beyond which a garment's upper opening is no waist."""
    return 0.5 * (body.waist_y + body.underarm_y)


def has_collar(mesh: GarmentMesh, seen: SeenGarment, body: BodyMeasurements) -> bool:
    """Returns whether the cloth at the neck stands up, or is folded over so that its edge lies below its top."""
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
    """Returns ``mesh`` without its collar, a tuple with a sentence on that, and the collar's width [m].

    Without a collar ``mesh`` is returned as it is, with an empty tuple. The width is 0 where the pattern shall have no
    collar: without one, with one that is too narrow or too wide to be drafted, and with one that stays. ``there`` has
    the number of openings of each part of the body, ``joints`` [m] (24, 3) are those of ``wearer`` in the target's
    pose. A collar stays, as the sentence says, where openings would change without it. Its width, stand and fall
    together, is its area over the length of the neckline that is left.
    """
    if there != OF_TOPS:
        return mesh, (), 0.0
    seen = SeenGarment(mesh.vertices, mesh.faces, joints, wearer.joints_template)
    if not has_collar(mesh, seen, measure_body(wearer)):
        return mesh, (), 0.0
    bare, gone = without_collar(mesh, joints)
    bare, after = close_but_openings(bare, joints, there)
    if after != there:
        return mesh, ("The target has a collar, which no base has: the neckline is drawn to its edge",), 0.0
    words = f"The target has a collar, which no base has: it was cut off at the neck, {gone:.0%} of the cloth"
    neck = SeenGarment(bare.vertices, bare.faces, joints, wearer.joints_template).openings[TRUNK][0].contour
    width = gone * float(meshes.face_areas(mesh.vertices, mesh.faces).sum()) / neck.length_m
    if not COLLARS_M[0] <= width <= COLLARS_M[1]:
        return bare, (f"{words}; the pattern ends at the neckline",), 0.0
    return bare, (f"{words}, about {100 * width:.0f} cm wide",), width


def panel_count(base: str, shown: int | None) -> dict[str, float]:
    """Returns {"panels": ``shown``} for a skirt whose texture shows 3 to ``MOST_PANELS`` gores, as settings of its
    base; otherwise empty."""
    return {COUNT: float(shown)} if base == "skirt" and shown is not None and 2 < shown <= MOST_PANELS else {}


def ring_panels(pattern: Pattern) -> list[str]:
    """Returns the names of panels that are sewn to themselves to a ring, as bands and one-piece sleeves are. The legs
    of a dart are neighbours and close no ring."""
    panels = []
    for stitch in pattern.stitches:
        panel, apart = stitch.first.panel, abs(stitch.first.edge - stitch.second.edge)
        if panel == stitch.second.panel and 1 < apart < len(pattern.panel(panel).edges) - 1:
            panels.append(panel)
    return panels


def differences(
    base: str, pattern: Pattern, seen: SeenGarment, body: BodyMeasurements, shown: int | None
) -> tuple[str, ...]:
    """Returns sentences on how the cut of the target ``seen`` on ``body`` differs from ``pattern``, drafted from
    ``base``.

    ``shown`` is the number of panels that its texture shows, None for none.
    """
    sentences = []
    if base in OPENINGS:
        nearest = tell_base(seen, body)
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


# --- collars ---------------------------------------------------------------------------------------------------------


def without_collar(mesh: GarmentMesh, joints: np.ndarray) -> tuple[GarmentMesh, float]:
    """Returns ``mesh`` cut along the neck of a body with ``joints`` [m] (24, 3), and the share of its area that is
    gone, from 0 to 1."""
    neck, chest = (joints[JOINT_NAMES.index(name)] for name in ("neck", "spine3"))
    up = (neck - chest) / np.linalg.norm(neck - chest)
    ahead = np.array([0.0, 0.0, 1.0]) - up[2] * up
    off = mesh.vertices - neck
    forward = off @ ahead
    height = off @ up + np.maximum(AHEAD * forward, -BEHIND * forward) - RISE_M
    away = np.linalg.norm(off - np.outer(off @ up, up), axis=1)
    before = meshes.face_areas(mesh.vertices, mesh.faces).sum()
    bare = main_sheet(below(mesh, np.minimum(height, NECK_RADIUS_M - away)))[0]
    gone = 1.0 - meshes.face_areas(bare.vertices, bare.faces).sum() / before
    return replace(bare, notes=mesh.notes), float(gone)


def below(mesh: GarmentMesh, height: np.ndarray) -> GarmentMesh:
    """Returns the part of ``mesh`` where ``height`` (V,), taken as linear in every triangle, is not positive, without
    texture coordinates. Triangles on the limit are cut."""
    up = height > 0.0
    above = up[mesh.faces].sum(axis=1)
    vertices, faces, parent = [mesh.vertices], [mesh.faces[above == 0]], [np.flatnonzero(above == 0)]
    edges = meshes.unique_edges(mesh.faces)
    crossed = edges[up[edges[:, 0]] != up[edges[:, 1]]]
    h = np.abs(height[crossed])
    share = (h[:, 0] / h.sum(axis=1))[:, None]
    vertices.append((1.0 - share) * mesh.vertices[crossed[:, 0]] + share * mesh.vertices[crossed[:, 1]])
    count = len(mesh.vertices)
    key = np.sort(crossed, axis=1) @ [count, 1]
    order = np.argsort(key)

    def cut(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """The new vertices on the edges from ``a`` to ``b`` (n,)."""
        wanted = np.minimum(a, b) * count + np.maximum(a, b)
        return count + order[np.searchsorted(key[order], wanted)]

    for number in (1, 2):
        mine = np.flatnonzero(above == number)
        corners = mesh.faces[mine]
        # The corner that is alone on its side comes first.
        alone = (up[corners] == (number == 1)).argmax(axis=1)
        a, b, c = (corners[np.arange(len(mine)), (alone + k) % 3] for k in range(3))
        ab, ac = cut(a, b), cut(a, c)
        new = [np.stack([ab, b, c], 1), np.stack([ab, c, ac], 1)] if number == 1 else [np.stack([a, ab, ac], 1)]
        faces += new
        parent += [mine] * len(new)
    return with_used_vertices(
        replace(
            mesh,
            vertices=np.concatenate(vertices),
            faces=np.concatenate(faces),
            uv=np.zeros((0, 2)),
            uv_faces=np.zeros((0, 3), dtype=np.int64),
            face_material=mesh.face_material[np.concatenate(parent)],
        )
    )
