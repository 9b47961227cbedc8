"""Whether sleeves and legs go round their limbs: at rest on the body, and in the frames of clips.

    python -m benchmarks.limbs                                     # the shipped garments
    python -m benchmarks.limbs --garments suit.obj --save          # a file with nothing said of it

A limb is looked at in planes across its bones, from the upper arm to the wrist and from below the crotch to the ankle.
A plane counts where cloth of the limb lies at rest on both sides of it, and between both legs: a skirt has none there.
The loop in which it cuts the cloth round the bone at rest is a line on the cloth, which moves with it. In a frame the
limb is inside where its bones go through that loop. An opening of a limb is such a line too; an opening of a limb's
size through which no bone goes is of a sleeve that hangs beside its arm, and counts as a line without a limb.
``loops``: how many lines there are; ``rest_pct``: those with a limb, ``inside_pct``: the same in all frames;
``worst_pct``: of the worst frame. A garment without sleeves and legs has none of them. ``area``: of the cloth over that
at rest, in the mean of frames; ``depth_mm``: how deep it is in the skin at the most.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.measure.depth import depth_mm
from benchmarks.tables import Row
from drape.body.skeleton import JOINT_NAMES
from drape.catalog import find_garments, find_motions, open_outfit
from drape.errors import DrapeError
from drape.garment.cache import Garment
from drape.garment.contours import TRUNK, Contour, bone_chains, encircles, open_contours, part_round
from drape.garment.fine import fine_garment
from drape.geometry import meshes
from drape.library import Drape, load

LIMBS = {
    f"{side} {limb}": tuple(JOINT_NAMES.index(f"{side}_{joint}") for joint in joints)
    for side in ("left", "right")
    for limb, joints in (("arm", ("shoulder", "elbow", "wrist")), ("leg", ("hip", "knee", "ankle")))
}
OTHER_LEG = {"left leg": "right leg", "right leg": "left leg"}
STARTS = {"arm": 0.25, "leg": 0.2}  # shares of a limb: above it cloth of the trunk lies near
PLANES = 24  # across a limb
NEAR_M = 0.16
OPENING_M, MOST_OPENING_M = 0.15, 1.0  # lengths of openings that a limb may go through
DEPTHS = 6  # frames of a clip whose depth in the skin is taken
LEAST = 3  # vertices between two planes that make cloth of the limb, and planes that make a sleeve
COLUMNS = {
    "garment": "s", "clip": "s", "limbs": "s", "loops": "d", "frames": "d", "rest_pct": ".1f", "inside_pct": ".2f",
    "worst_pct": ".1f", "area": ".3f", "depth_mm": ".1f", "refused": "s",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class LimbLoop:
    """A closed line on a mesh: point k lies on the edge ``ends`` (K, 2) at ``share`` (K, 1) from its first vertex."""

    ends: np.ndarray
    share: np.ndarray

    def contour(self, vertices: np.ndarray) -> Contour:
        """The line on ``vertices`` [m] (V, 3)."""
        first, second = vertices[self.ends[:, 0]], vertices[self.ends[:, 1]]
        points = first + self.share * (second - first)
        length_m = float(np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).sum())
        return Contour(self.ends[:, 0], points, length_m, points.mean(axis=0))


def stations(joints: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] (P, 3) on the bones of a limb of ``joints`` [m] (24, 3), and the bones' directions there (P, 3)."""
    chain = joints[list(LIMBS[name])]
    lengths = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    along = np.linspace(STARTS[name.split()[1]], 0.98, PLANES) * lengths.sum()
    knots = np.concatenate([[0.0], np.cumsum(lengths)])
    points = np.stack([np.interp(along, knots, chain[:, axis]) for axis in range(3)], axis=1)
    bone = np.minimum(np.searchsorted(knots, along, side="right") - 1, len(lengths) - 1)
    return points, (np.diff(chain, axis=0) / lengths[:, None])[bone]


def loops(vertices: np.ndarray, faces: np.ndarray, point: np.ndarray, direction: np.ndarray) -> list[LimbLoop]:
    """The closed lines in which the plane through ``point`` (3,) across ``direction`` (3,) cuts a mesh."""
    height = (vertices - point) @ direction
    above = height[faces] > 0.0
    crossed = faces[above.any(axis=1) & ~above.all(axis=1)]
    beside: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for face in crossed.tolist():
        pairs = zip(face, face[1:] + face[:1], strict=True)
        first, second = ((min(pair), max(pair)) for pair in pairs if (height[pair[0]] > 0.0) != (height[pair[1]] > 0.0))
        beside.setdefault(first, []).append(second)
        beside.setdefault(second, []).append(first)
    found, seen = [], set()
    for start in beside:
        if start in seen:
            continue
        line, at = [start], start
        seen.add(start)
        while following := [edge for edge in beside[at] if edge not in seen]:
            at = following[0]
            seen.add(at)
            line.append(at)
        if len(line) > 2 and start in beside[at]:
            ends = np.array(line)
            low, high = height[ends[:, 0]], height[ends[:, 1]]
            found.append(LimbLoop(ends, (low / (low - high))[:, None]))
    return found


def loop_round(
    vertices: np.ndarray, faces: np.ndarray, point: np.ndarray, direction: np.ndarray, chain: np.ndarray
) -> LimbLoop | None:
    """The shortest of the ``loops`` that the line ``chain`` [m] (n, 3) goes through, if there is one."""
    there = loops(vertices, faces, point, direction)
    round_it = [one for one in there if encircles(one.contour(vertices), chain)]
    return min(round_it, key=lambda one: one.contour(vertices).length_m, default=None)


def chain_of(joints: np.ndarray, name: str) -> np.ndarray:
    """The line [m] (n, 3) of a limb's bones, which goes on beyond the hand or the foot."""
    return bone_chains(joints)[name.replace(" ", "_")][0]


def limb_loops(garment: Garment, joints: np.ndarray) -> dict[str, list[LimbLoop | None]]:
    """By limb the loop of every plane where cloth of that limb lies, at rest on ``joints`` [m] (24, 3)."""
    points, faces = garment.vertices[: garment.vertex_count].astype(np.float64), garment.faces.astype(np.int64)
    places = {name: stations(joints, name) for name in LIMBS}
    away = {name: np.linalg.norm(points[:, None] - at[None], axis=2) for name, (at, _) in places.items()}
    nearest = np.stack([one.min(axis=1) for one in away.values()])
    found = {}
    for row, (name, distances) in enumerate(away.items()):
        own = (nearest[row] < NEAR_M) & (nearest.argmin(axis=0) == row)
        held = np.bincount(distances[own].argmin(axis=1), minlength=PLANES) >= LEAST
        numbers = np.flatnonzero(held[1:-1] & held[:-2] & held[2:]) + 1
        (at, ways), chain = places[name], chain_of(joints, name)
        round_it = [loop_round(points, faces, at[i], ways[i], chain) for i in numbers]
        if name in OTHER_LEG:
            other = chain_of(joints, OTHER_LEG[name])
            both = [one is not None and encircles(one.contour(points), other) for one in round_it]
            # A loop round both legs is a skirt's; where that ends obliquely, or has a slit, a plane has no closed line.
            if any(both) or all(one is None for one in round_it):
                round_it = []
        found[name] = round_it
    found = {name: loops for name, loops in found.items() if len(loops) >= LEAST}
    for part, line in limb_openings(points, faces, joints):
        found.setdefault(part, []).append(line)
    return found


def limb_openings(points: np.ndarray, faces: np.ndarray, joints: np.ndarray) -> list[tuple[str, LimbLoop | None]]:
    """Returns the openings of a mesh, ``points`` [m] (V, 3) and ``faces`` (F, 3), each with the limb that goes through
    it.

    ``joints`` [m] (24, 3) are those of the body. An opening of a limb's size that no part of the body goes through is
    listed as "none", without a loop.
    """
    chains, found = bone_chains(joints), []
    for one in open_contours(points, faces):
        part = part_round(one, chains)
        if part is None and OPENING_M < one.length_m < MOST_OPENING_M:
            found.append(("none", None))
        elif part not in (None, TRUNK):
            found.append(
                (part.replace("_", " "), LimbLoop(np.stack([one.loop, one.loop], axis=1), np.zeros((len(one.loop), 1))))
            )
    return found


def share_inside(vertices: np.ndarray, joints: np.ndarray, held: dict[str, list[LimbLoop | None]]) -> float:
    """The share of the loops ``held`` on ``vertices`` [m] (V, 3) that their limb's bones of ``joints`` go through."""
    inside = [
        one is not None and encircles(one.contour(vertices), chain_of(joints, name))
        for name, found in held.items()
        for one in found
    ]
    return float(np.mean(inside))


@Benchmark(
    "limbs",
    "Whether sleeves and legs go round their limbs.",
    COLUMNS,
    *inputs(quick_garments=("tshirt", "trousers"), quick_motions=("walk",)),
    Option("--frames", 40, "of a clip at most", 6),
    Option("--tier", "balanced", "that drapes"),
)
def main(run: Run) -> None:
    """Adds a row to ``run`` for every garment of every file in every clip."""
    drape = load()
    for path in find_garments(run.options.garments):
        try:
            run.add(outfit_rows(drape, open_outfit(path, drape.body), run.options))
        except DrapeError as error:
            run.add([{"garment": path.stem, "refused": str(error)[:90]}])


def outfit_rows(drape: Drape, garments: list[Garment], options: argparse.Namespace) -> list[Row]:
    """The rows of the garments of one file, worn together, of their cloth."""
    worn, cloth = drape.wear(garments, tier=options.tier, resolution="fine"), [fine_garment(one) for one in garments]
    ends = np.cumsum([one.vertex_count for one in cloth])[:-1]
    rest = drape.body.joints_template
    held = [limb_loops(one, rest) for one in cloth]
    shared: list[Row] = []
    for one, found in zip(cloth, held, strict=True):
        row: Row = {"garment": one.name, "limbs": ", ".join(found), "loops": sum(map(len, found.values()))}
        if found:
            row["rest_pct"] = 100.0 * share_inside(one.vertices.astype(np.float64), rest, found)
        shared.append(row)
    rows = []
    for motion in find_motions(options.motions):
        clip = worn.placed(motion)
        step = max(1, clip.frame_count // options.frames)
        joints = drape.body.posed_joints(clip.poses) + clip.trans[:, None]
        skins = drape.body.posed_vertices(clip.poses[::step]) + clip.trans[::step, None]
        measured: list[list[tuple[float, float, float]]] = [[] for _ in cloth]
        for number, frame in enumerate(worn.play(clip, as_recorded=True)):
            if number % step == 0:
                deep = number // step % max(1, options.frames // DEPTHS) == 0
                skin = skins[number // step]
                parts = np.split(frame.vertices.astype(np.float64), ends)
                for one, found, vertices, told in zip(cloth, held, parts, measured, strict=True):
                    inside = share_inside(vertices, joints[number], found) if found else np.nan
                    depth = depth_mm(vertices, skin, drape.body.faces) if deep else np.nan
                    told.append((inside, area_over_rest(vertices, one), depth))
        for row, told in zip(shared, measured, strict=True):
            inside, area, depth = np.array(told).T
            figures = {"area": float(area.mean()), "depth_mm": float(np.nanmax(depth)), "frames": len(told)}
            if row["limbs"]:
                figures |= {"inside_pct": 100.0 * float(inside.mean()), "worst_pct": 100.0 * float(inside.min())}
            rows.append(row | {"clip": clip.name} | figures)
    return rows


def area_over_rest(vertices: np.ndarray, garment: Garment) -> float:
    """The area of the cloth at ``vertices`` [m] (V, 3) over that of the ``garment`` at rest."""
    faces = garment.faces.astype(np.int64)
    rest = meshes.face_areas(garment.vertices.astype(np.float64), faces)
    return float(meshes.face_areas(vertices, faces).sum() / rest.sum())


if __name__ == "__main__":
    main.command()
