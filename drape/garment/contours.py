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

SHORT_SHARE = 0.14  # of the root of the area: no cuff is as short as this; 14 cm for a square metre
LONG_SHARE = 0.35  # of the same: a longer border may be a neckline, which lies in flat cloth on broad shoulders
LIES_IN_CLOTH = 0.85  # cosine between the cloth's normals at a rim and the hole's own: a neckline has 0.7, a cuff 0.2
LOOKS_SIDEWAYS = 0.6  # below it is a tube's end; a border between the two needs a body to be told
SMOOTHINGS = 4
TRUNK = "trunk"
LIMBS = {
    "left_leg": ("left_hip", "left_knee", "left_ankle"),
    "right_leg": ("right_hip", "right_knee", "right_ankle"),
    "left_arm": ("left_collar", "left_shoulder", "left_elbow", "left_wrist", "left_hand"),
    "right_arm": ("right_collar", "right_shoulder", "right_elbow", "right_wrist", "right_hand"),
}
SPINE = ("pelvis", "neck", "head")  # straight: at the kinks of the spine the nearest point jumps by centimetres
MIDDLES = ("ankle", "knee")  # of both legs, from below
BEYOND_M = 0.2  # that a chain goes on after its last joint: hems below the ankle, cuffs over the hand
OTHER_PART = 100.0  # cost [m^2] of matching contours of different parts: never, as long as there is a choice


class Loop(NamedTuple):
    """A border: vertices ``loop`` (n,) in order, its ``length``, and how much it lies in the cloth, from 0 to 1.

    ``axis`` (3,) is the normal of the plane that it spans.
    """

    loop: np.ndarray
    length: float
    flatness: float
    axis: np.ndarray


def borders(mesh: GarmentMesh) -> list[Loop]:
    """The borders of ``mesh``, whose faces agree in orientation, longest first."""
    normals = meshes.vertex_normals(mesh.vertices, mesh.faces)
    averaging = mesh_graphs.umbrella_laplacian(mesh.faces, len(mesh.vertices))
    for _ in range(SMOOTHINGS):  # noise tilts single normals
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
    return sorted(loops, key=lambda one: -one.length)


def plainly_hole(one: Loop, mesh: GarmentMesh) -> bool:
    """Returns whether a border is a hole, as far as the cloth alone tells: it is very short, or lies in the middle of
    the cloth."""
    root = float(np.sqrt(meshes.face_areas(mesh.vertices, mesh.faces).sum()))
    lies = one.flatness > LIES_IN_CLOTH and one.length < LONG_SHARE * root
    return one.length < SHORT_SHARE * root or lies


def plainly_opening(one: Loop) -> bool:
    """Returns whether a border is an opening, as far as the cloth alone tells: the cloth at it looks sideways."""
    return one.flatness < LOOKS_SIDEWAYS


@dataclass(frozen=True, eq=False)
class Contour:
    """A closed border: ``loop`` (n,) vertices in order, ``length_m`` and ``centre`` [m] (3,), the mean along it."""

    loop: np.ndarray
    points: np.ndarray
    length_m: float
    centre: np.ndarray


class ContourPlace(NamedTuple):
    """The place of a contour: the body's ``part``, ``along_m`` [m] from its root, unit ``direction`` (3,) outward.

    The trunk begins at the pelvis, up is positive; a limb begins at its first joint. ``part`` is None if no bone passes
    through.
    """

    part: str | None
    along_m: float
    direction: np.ndarray


class Match(NamedTuple):
    """A contour of the source and its counterpart, by number; the target's length over the source's.

    The counterpart lies ``move_m`` [m] further along the direction of the source's ``place``.
    """

    source: int
    target: int
    place: ContourPlace
    length_ratio: float
    move_m: float


def open_contours(vertices: np.ndarray, faces: np.ndarray) -> list[Contour]:
    """The closed borders of a mesh (``vertices`` [m] (V, 3), ``faces`` (F, 3)), longest first."""
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
    """By part of the body the points [m] (n, 3) of its bones, and the length [m] before its root.

    ``joints`` [m] (24, 3) in the pose of the garment.
    """
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
    """Whether the line ``chain`` [m] (n, 3) passes through ``contour``, counted on the fan about its centre."""
    return sum(_crossings(chain, contour.centre, contour.points, np.roll(contour.points, -1, axis=0))) != 0


def pierces(chain: np.ndarray, nodes: np.ndarray, faces: np.ndarray) -> bool:
    """Whether the line ``chain`` [m] (n, 3) goes through the cloth of ``nodes`` [m] (N, 3) and ``faces`` (F, 3)."""
    # Most triangles lie away from the line.
    above, below = (nodes >= chain.min(axis=0)).T, (nodes <= chain.max(axis=0)).T
    near = np.ones(len(faces), dtype=bool)
    for side in (*above, *below):
        near &= side[faces[:, 0]] | side[faces[:, 1]] | side[faces[:, 2]]
    return bool(_crossings(chain, *nodes[faces[near]].transpose(1, 0, 2)))


def _crossings(chain: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> list[int]:
    """1 or -1, by the side that it comes from, where ``chain`` (n, 3) goes through a triangle ``a``, ``b``, ``c``."""
    signs = [crossed(start, end, a, b, c) for start, end in pairwise(chain)]
    return [int(sign) for found in signs for sign in found[found != 0]]


def crossed(start: np.ndarray, end: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """1 or -1 (F,), by the side that it comes from, where the line from ``start`` to ``end`` (3,) goes through the
    triangles ``a``, ``b``, ``c`` (F, 3), 0 elsewhere."""
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
    """The part of the body whose bones pass through ``contour``, the trunk before a limb."""
    return next((name for name, (chain, _) in chains.items() if encircles(contour, chain)), None)


def place_of(contour: Contour, chains: dict[str, tuple[np.ndarray, float]]) -> ContourPlace:
    """The place of ``contour`` along the body, on the part that it goes round.

    Where no bone passes through, as through a cuff that lies folded, the nearest one counts if it is nearer to the
    centre than a round contour of that length would be.
    """
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
    """Every contour of ``source`` with its counterpart, and the numbers of the target's holes, which have none.

    Counterparts lie on the same part of the body; on each part the squared differences of their places are least
    in sum, which keeps their order. Raises ``InputError`` where the target has no counterpart.
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
    """Returns the ``parts`` of the body that do not go through an opening of a garment at ``nodes`` [m] (N, 3), one
    opening for each.

    A limb whose bones go through the cloth is lost too: its sleeve slipped off and only the cuff is still round the
    arm. ``joints`` [m] (24, 3) are those of the body in its pose.
    """
    chains = bone_chains(joints)
    there = Counter(filter(None, (part_round(contour, chains) for contour in open_contours(nodes, faces))))
    lost = (Counter(parts) - there) | Counter(set(pierced_parts(nodes, faces, joints)) & set(parts) - {TRUNK})
    return tuple(sorted(lost.elements()))


def pierced_parts(nodes: np.ndarray, faces: np.ndarray, joints: np.ndarray) -> tuple[str, ...]:
    """The parts of the body whose bones go through the cloth of ``nodes`` [m] (N, 3): a limb's, or pelvis to head."""
    bones = {part: chain[:-1] for part, (chain, _) in bone_chains(joints).items()}  # beyond the last joint is none
    bones[TRUNK] = bones[TRUNK][-len(SPINE) :]
    return tuple(part for part, chain in bones.items() if pierces(chain, nodes, faces))


def lost_words(lost: Sequence[str]) -> str:
    """A phrase such as "the right arm is not in its opening"."""
    parts = " and ".join(f"the {part.replace('_', ' ')}" for part in lost)
    return f"{parts} {'is' if len(lost) == 1 else 'are'} not in the garment's opening"
