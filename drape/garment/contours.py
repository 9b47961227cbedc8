"""Borders of a garment's cloth: which is a hole, which an opening, and where along the body openings lie.

As far as the cloth alone tells: a hole lies in the cloth, so the cloth at its rim looks the way that the hole does; at
the rim of a cuff the cloth looks sideways. Where a body is known its bones decide.

Algorithm 2 of Yu, Cordier and Seo (2024) pairs a drape's contours with a target's. A contour belongs to the part of the
body whose bones pass through it; its place is the point of that part's chain of bones nearest to its centre. Below the
pelvis a middle line between both legs continues the trunk, so that the hem of a shirt has one coordinate whether it
ends above or below the hips.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from drape.arrays import check_finite, check_shape
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES
from drape.errors import InputError, MeshError
from drape.garment.files.mesh import GarmentMesh
from drape.geometry import mesh_graphs, meshes

SHORT_SHARE = 0.14  # no cuff is shorter than this share of the root of the area, 14 cm for a square metre
LONG_SHARE = 0.35  # a longer border may be a neckline, which lies in flat cloth on broad shoulders
LIES_IN_CLOTH = 0.85  # cosine between the cloth's normals at a rim and the hole's own: a neckline has 0.7, a cuff 0.2
LOOKS_SIDEWAYS = 0.6  # a tube's end has less; what a border between the two is, only a body can show
SMOOTHINGS = 4
TRUNK = "trunk"
LIMBS = {
    "left_leg": ("left_hip", "left_knee", "left_ankle"),
    "right_leg": ("right_hip", "right_knee", "right_ankle"),
    "left_arm": ("left_collar", "left_shoulder", "left_elbow", "left_wrist", "left_hand"),
    "right_arm": ("right_collar", "right_shoulder", "right_elbow", "right_wrist", "right_hand"),
}
SPINE = ("pelvis", "neck", "head")  # a straight line: at the kinks of the spine the nearest point jumps by centimetres
MIDDLES = ("ankle", "knee")  # midpoints between both legs continue the trunk, from below
BEYOND_M = 0.2  # chains go on after their last joint, for hems below the ankle and cuffs over the hand
OTHER_PART = 100.0  # cost [m^2] of matching contours of different parts, so that it never pays


class Loop(NamedTuple):
    """A border of a mesh: ``loop`` (n,), its vertices in order; ``length``, in the mesh's unit; ``flatness`` in [0, 1];
    and ``axis`` (3,), the unit normal of the plane that it spans. ``flatness`` is the mean of |vertex normal . axis|
    along the border: 1 for a hole in flat cloth, 0 at the end of a tube."""

    loop: np.ndarray
    length: float
    flatness: float
    axis: np.ndarray


def borders(mesh: GarmentMesh) -> list[Loop]:
    """Returns the borders of ``mesh``, the longest first. Its faces must be wound consistently."""
    normals = meshes.vertex_normals(mesh.vertices, mesh.faces)
    averaging = mesh_graphs.umbrella_laplacian(mesh.faces, len(mesh.vertices))
    for _ in range(SMOOTHINGS):  # because noise tilts single normals
        normals = normals + averaging @ normals
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    loops = []
    for loop in meshes.boundary_loops(mesh.faces):
        points = mesh.vertices[loop]
        way = np.roll(points, -1, axis=0) - points
        length = np.linalg.norm(way, axis=1)
        axis = 0.5 * np.cross(points - points.mean(axis=0), way).sum(axis=0)
        axis = axis / max(float(np.linalg.norm(axis)), 1e-300)
        flatness = float((length * np.abs(normals[loop] @ axis)).sum() / max(float(length.sum()), 1e-300))
        loops.append(Loop(loop, float(length.sum()), flatness, axis))
    return sorted(loops, key=lambda border: -border.length)


def plainly_hole(border: Loop, mesh: GarmentMesh) -> bool:
    """Returns whether ``border`` of ``mesh`` is a hole that nothing is worn through, as far as the cloth alone shows:
    it is very short, or lies in the middle of flat cloth."""
    root = float(np.sqrt(meshes.face_areas(mesh.vertices, mesh.faces).sum()))
    lies = border.flatness > LIES_IN_CLOTH and border.length < LONG_SHARE * root
    return border.length < SHORT_SHARE * root or lies


def plainly_opening(border: Loop) -> bool:
    """Returns whether ``border`` is an opening to wear, as far as the cloth alone shows: the cloth at it looks
    sideways, as at a cuff."""
    return border.flatness < LOOKS_SIDEWAYS


@dataclass(frozen=True, eq=False)
class Contour:
    """A closed border: ``loop`` (n,), its vertices in order; ``points`` [m] (n, 3), their positions; ``length_m``; and
    ``centre`` [m] (3,), the mean position along it."""

    loop: np.ndarray
    points: np.ndarray
    length_m: float
    centre: np.ndarray


class ContourPlace(NamedTuple):
    """Where a contour lies along the body: the ``part`` of the body ("trunk", "left_arm", ...), ``along_m`` [m], the
    length along the part's bones, and the unit ``direction`` (3,) of the bones there. On the trunk ``along_m`` counts
    upwards from the pelvis, on a limb outwards from its first joint. ``part`` is None if no bone passes through the
    contour; ``along_m`` and ``direction`` are zero then."""

    part: str | None
    along_m: float
    direction: np.ndarray


class Match(NamedTuple):
    """A contour of the source and its counterpart in the target: ``source`` and ``target`` are their numbers in the two
    lists, ``place`` is that of the source. ``length_ratio`` is the target's length over the source's; the counterpart
    lies ``move_m`` [m] farther along the part's bones."""

    source: int
    target: int
    place: ContourPlace
    length_ratio: float
    move_m: float


def open_contours(vertices: np.ndarray, faces: np.ndarray) -> list[Contour]:
    """Returns the closed borders of the mesh with ``vertices`` [m] (V, 3) and ``faces`` (F, 3), the longest first.
    Raises ``MeshError`` for arrays that are no finite mesh."""
    vertices = np.asarray(vertices, dtype=np.float64)
    check_shape("vertices", vertices, (None, 3), error=MeshError)
    check_finite("vertices", vertices, error=MeshError)
    faces = meshes.check_faces(faces, len(vertices))
    contours = []
    for loop in meshes.boundary_loops(faces):
        points = vertices[loop]
        following = np.roll(points, -1, axis=0)
        lengths = np.linalg.norm(following - points, axis=1)
        centre = (lengths[:, None] * 0.5 * (points + following)).sum(axis=0) / max(lengths.sum(), 1e-300)
        contours.append(Contour(loop, points, float(lengths.sum()), centre))
    return sorted(contours, key=lambda contour: -contour.length_m)


def bone_chains(joints: np.ndarray) -> dict[str, tuple[np.ndarray, float]]:
    """Returns for each part of the body ("trunk", "left_leg", "right_leg", "left_arm", "right_arm") the polyline [m]
    (n, 3) along its bones, and the length [m] of the polyline up to the part's origin: to the pelvis for the trunk, 0
    for limbs. ``joints`` [m] (24, 3), in any pose. Chains go on for ``BEYOND_M`` after their last joints; the trunk
    begins below, between the ankles."""
    check_shape("joints", joints, (JOINT_COUNT, 3))
    check_finite("joints", joints)
    at = dict(zip(JOINT_NAMES, joints, strict=True))
    middle = [0.5 * (at[f"left_{name}"] + at[f"right_{name}"]) for name in MIDDLES]
    trunk = _longer(_longer(np.array([*middle, *(at[name] for name in SPINE)]))[::-1])[::-1]
    below = float(np.linalg.norm(np.diff(trunk[: len(MIDDLES) + 2], axis=0), axis=1).sum())
    chains = {TRUNK: (trunk, below)}
    chains.update({part: (_longer(np.array([at[name] for name in names])), 0.0) for part, names in LIMBS.items()})
    return chains


def _longer(chain: np.ndarray) -> np.ndarray:
    last = chain[-1] - chain[-2]
    return np.concatenate([chain, [chain[-1] + BEYOND_M * last / max(float(np.linalg.norm(last)), 1e-300)]])


def encircles(contour: Contour, chain: np.ndarray) -> bool:
    """Returns whether the polyline ``chain`` [m] (n, 3) passes through ``contour``: it crosses the fan of triangles
    around the contour's centre more often in one direction than in the other."""
    return sum(_crossings(chain, contour.centre, contour.points, np.roll(contour.points, -1, axis=0))) != 0


def pierces(chain: np.ndarray, nodes: np.ndarray, faces: np.ndarray) -> bool:
    """Returns whether the polyline ``chain`` [m] (n, 3) crosses a triangle of the cloth with vertices ``nodes`` [m] (N,
    3) and ``faces`` (F, 3)."""
    # Most triangles lie away from the line.
    above, below = (nodes >= chain.min(axis=0)).T, (nodes <= chain.max(axis=0)).T
    near = np.ones(len(faces), dtype=bool)
    for side in (*above, *below):
        near &= side[faces[:, 0]] | side[faces[:, 1]] | side[faces[:, 2]]
    return bool(_crossings(chain, *nodes[faces[near]].transpose(1, 0, 2)))


def _crossings(chain: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> list[int]:
    """1 or -1, by the side that it comes from, where ``chain`` (n, 3) goes through a triangle ``a``, ``b``, ``c``."""
    signs = [crossed(start, end, a, b, c) for start, end in pairwise(chain)]
    return [int(sign) for crossings in signs for sign in crossings[crossings != 0]]


def crossed(start: np.ndarray, end: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Returns for each triangle ``a``, ``b``, ``c`` (F, 3) whether the segment from ``start`` to ``end`` (3,) crosses
    it: 1 along its normal, -1 against it, 0 where it does not, floats (F,). A crossing at ``end`` does not count."""
    way, normal = end - start, np.cross(b - a, c - a)
    rise = normal @ way
    with np.errstate(divide="ignore", invalid="ignore"):
        t = ((a - start) * normal).sum(axis=1) / rise
        point = start + t[:, None] * way
        hit = (t >= 0.0) & (t < 1.0) & (rise != 0.0)
        for p, q in ((a, b), (b, c), (c, a)):
            hit &= (np.cross(q - p, point - p) * normal).sum(axis=1) >= 0.0
    return np.where(hit, np.sign(rise), 0.0)


def part_round(contour: Contour, chains: dict[str, tuple[np.ndarray, float]]) -> str | None:
    """Returns the name of the body's part whose bones pass through ``contour``, the trunk before a limb, or None.
    ``chains``: what ``bone_chains`` returns."""
    return next((name for name, (chain, _) in chains.items() if encircles(contour, chain)), None)


def place_of(contour: Contour, chains: dict[str, tuple[np.ndarray, float]]) -> ContourPlace:
    """Returns the place of ``contour`` along the part of the body that it goes around. ``chains``: what ``bone_chains``
    returns. Where no bone passes through, as through a cuff that lies folded, the part with the nearest bone counts if
    the bone is nearer to the centre than a round contour of that length would be; else the place has the part None."""
    nearest = {part: _nearest(contour.centre, chain) for part, (chain, _) in chains.items()}
    part = part_round(contour, chains)
    if part is None:
        part = min(nearest, key=lambda name: nearest[name][0])
        if nearest[part][0] > contour.length_m / (2.0 * np.pi):
            return ContourPlace(None, 0.0, np.zeros(3))
    _, along, direction = nearest[part]
    return ContourPlace(part, along - chains[part][1], direction)


def _nearest(point: np.ndarray, chain: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Distance [m] of ``point`` to the line ``chain`` (n, 3), arc length of the nearest point, direction there."""
    candidates, run = [], 0.0
    for start, end in pairwise(chain):
        length = max(float(np.linalg.norm(end - start)), 1e-300)
        way = (end - start) / length
        share = float(np.clip((point - start) @ way, 0.0, length))
        candidates.append((float(np.linalg.norm(point - start - share * way)), run + share, way))
        run += length
    return min(candidates, key=lambda one: one[0])


def match_contours(source: list[Contour], target: list[Contour], joints: np.ndarray) -> tuple[list[Match], list[int]]:
    """Returns a match for each contour of ``source``, and the numbers of the contours of ``target`` that have no
    counterpart: holes. ``joints`` [m] (24, 3) of the body that both lie on.

    Counterparts lie on the same part of the body. On each part the sum of the squared differences of ``along_m`` is
    least, which keeps their order. Raises ``InputError`` where no bone passes through a contour of ``source``, or where
    ``target`` has fewer contours on a part.
    """
    chains = bone_chains(joints)
    own = [place_of(contour, chains) for contour in source]
    theirs = [place_of(contour, chains) for contour in target]
    for number, place in enumerate(own):
        if place.part is None:
            raise InputError(
                "base garment",
                expected="openings that the body passes through",
                got=f"one of {source[number].length_m:.2f} m that no bone passes through",
                cure="Drape the base pattern on the body first, and pass the joints of the same pose.",
            )
    for part in sorted({place.part for place in own if place.part}):
        wanted, there = (sum(place.part == part for place in places) for places in (own, theirs))
        if there < wanted:
            raise InputError(
                "target",
                expected=f"{wanted} openings round the {part.replace('_', ' ')}",
                got=f"{there}",
                cure="Take a base pattern of the target's kind, and cut what closes the target's openings.",
            )
    cost = np.array(
        [[OTHER_PART if a.part != b.part else (a.along_m - b.along_m) ** 2 for b in theirs] for a in own]
    ).reshape(len(own), len(theirs))
    from scipy.optimize import linear_sum_assignment  # half a second, which an intake need not wait for

    rows, columns = linear_sum_assignment(cost)
    matches = [
        Match(i, j, own[i], target[j].length_m / source[i].length_m, theirs[j].along_m - own[i].along_m)
        for i, j in zip(rows.tolist(), columns.tolist(), strict=True)
    ]
    return matches, sorted(set(range(len(target))) - set(columns.tolist()))


def lost_parts(nodes: np.ndarray, faces: np.ndarray, joints: np.ndarray, parts: Sequence[str]) -> tuple[str, ...]:
    """Returns those of ``parts``, names as in ``bone_chains``, that do not go through an opening of their own in the
    garment with vertices ``nodes`` [m] (N, 3) and ``faces`` (F, 3), sorted; empty if none is lost. A limb whose bones
    go through the cloth is lost too: its sleeve slipped off and only the cuff is still round the arm. ``joints`` [m]
    (24, 3) are those of the body in its pose."""
    chains = bone_chains(joints)
    there = Counter(filter(None, (part_round(contour, chains) for contour in open_contours(nodes, faces))))
    lost = (Counter(parts) - there) | Counter(set(pierced_parts(nodes, faces, joints)) & set(parts) - {TRUNK})
    return tuple(sorted(lost.elements()))


def pierced_parts(nodes: np.ndarray, faces: np.ndarray, joints: np.ndarray) -> tuple[str, ...]:
    """Returns the names of the body's parts whose bones go through the cloth with vertices ``nodes`` [m] (N, 3) and
    ``faces`` (F, 3); empty if there are none. Of the trunk only the bones from pelvis to head count. ``joints`` [m]
    (24, 3)."""
    bones = {part: chain[:-1] for part, (chain, _) in bone_chains(joints).items()}  # no bone is beyond the last joint
    bones[TRUNK] = bones[TRUNK][-len(SPINE) :]
    return tuple(part for part, chain in bones.items() if pierces(chain, nodes, faces))


def lost_words(lost: Sequence[str]) -> str:
    """Returns a clause about the ``lost`` parts, such as "the right arm is not in the garment's opening"."""
    parts = " and ".join(f"the {part.replace('_', ' ')}" for part in lost)
    return f"{parts} {'is' if len(lost) == 1 else 'are'} not in the garment's opening"
