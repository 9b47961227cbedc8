"""Who wore a garment that came with nothing said: its unit, axes and place, and the arms and shape of the body in it.

Every reading of the file (unit, up axis, facing) is laid over the known bodies at every height, and judged by cloth in
the skin, cloth far from it and bones that cloth does not go round (``wearer_fields``). The best are fitted: shape, pose
and place of the standard body by ``inside.fit_from``. Where no unit fits, sizes between the units are tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.errors import MeshError
from drape.garment.contours import Contour, open_contours, pierced_parts
from drape.garment.files.mesh import GarmentMesh
from drape.garment.inside import fit_from, tube_ends
from drape.garment.mesh_checks import AREA_MINIMUM, UNITS_M, consistent_turn
from drape.garment.registration import posed_by, start_parameters, unpack
from drape.garment.wearer_fields import (
    CELL_M,
    KNOWN,
    SHAPES,
    Bones,
    Field,
    bones_of,
    cloth_points,
    enclosed,
    joints_of,
    known_fields,
    point_cost,
    thin_body,
    unthreaded,
)
from drape.garment.wearer_reading import USUAL_FRONTS, Reading, Wearer, readings_of
from drape.geometry import mesh_graphs, meshes

EXTENT_M = (0.12, 2.4)  # of a garment
FREE_EXTENTS_M = 0.3 * 1.2 ** np.arange(10)  # tried where no unit fits
COARSE_COUNT, FINE_COUNT, FIT_COUNT = 350, 800, 500  # points on the cloth
BAND_M, BAND_WEIGHT = 0.15, 2.0  # from the top: there a garment hangs on its body
RISE_CELLS, DEPTH_CELLS = 2, np.arange(-4, 5, 2, dtype=np.int32)
PLACES, READINGS, PIERCED_COUNT, FINALISTS, WINNERS = 2, 8, 40, 6, 2
CLEARLY = 0.1  # a fit that is worse by this after a few steps stays worse
FIRST_STEPS, LAST_STEPS = 5, 15
SMALL_M2, SMALL = 0.4, 0.05  # a whole outfit read as a collar costs this for every e-fold less of cloth
SHAPE_COST = 0.01  # of a squared beta beside the nearest known shape's
UPRIGHT = [JOINT_NAMES.index(name) for name in ("pelvis", "spine1", "spine2", "spine3", "neck", "head")]
TURNED_COST = 0.3  # of a squared radian of all these together: who wears a garment stands straight
HEIGHT_M, HEIGHT_SPREAD_M, HEIGHT_COST = 1.73, 0.13, 0.01  # of people; the cost of one spread
# Costs of a body whose root and soles are away from the origin, of a bone through the cloth, of cloth on one side
# alone, and of an opening without a bone.
ODD_ORIGIN, ODD_PIERCED, ODD_SIDE, ODD_EMPTY = 0.03, 0.1, 0.3, 0.05
SLACK = 0.1  # wide legs and hems would slide up to where the body is wider; what carries a garment is its top
AT_ONCE = np.zeros(1, dtype=np.int32)
# What a metre from its place is worth, where the file's origin is at the root, on the floor, or anywhere. Roots are
# higher or lower in other makers' bodies.
ORIGIN_PRIOR_M = {"root": np.array([0.2, 0.06, 0.2]), "floor": np.array([0.2, 1e-4, 0.2]), "": np.full(3, 1e-4)}
ORIGIN_M = 0.05  # a body whose root or soles are this near to the file's origin stands where bodies do
CUFF_M = 0.12  # shorter openings are holes
LOOP_SHARE, LOOP_COUNT, LOOP_POINTS = 0.2, 6, 24  # openings over the extent, the most that count, points on each
INSIDE_LIMIT, OPEN_LIMIT, BAND_LIMIT_M = 0.12, 0.35, 0.08
DEEP_M = 0.01
SLEEVE_SHARE = 0.04  # of the cloth that must lie on the arms to tell their pose
UNIT_INSIDE, UNIT_ENOUGH = 0.06, 0.3  # cloth inside, and energy, up to which a unit is meant
LOOSE_INSIDE, LOOSE_ENOUGH = 0.015, 0.45  # the same of capes and other cloth that stands off
ENERGY_LIMIT = 0.7  # a body beyond has not worn it
# Cloth inside, open share and energy of a garment on the standard body at its origin, and of one in metres, y up.
LIMITS, PLAIN_LIMITS = (0.005, 0.2, 0.6), (0.002, 0.45, 0.8)
SHAPE_PRIOR_M = np.array([5.0e-3, *[2.5e-3] * 9])  # of the betas in a fit: the first one is the height
HELD_M, HELD = 0.06, 0.12  # moved so far up or down, the energy rises by this where a garment does not slide;
HELD_ORIGIN = 0.5  # the file's origin is as good a sign
RIVAL = 0.15  # a reading that is worse by this leaves no doubt


def find_wearers(mesh: GarmentMesh, body: BodyModel, *, unit: str = "auto", up: str = "auto") -> list[Wearer]:
    """The bodies that may have worn ``mesh``, best first, one for each reading; what ``unit`` and ``up`` say holds."""
    cloth = _Cloth(mesh)
    units = UNITS_M if unit == "auto" else {unit: UNITS_M[unit]}
    ups = tuple(f"{sign}{axis}" for axis in ("yzx" if up == "auto" else up) for sign in "+-")
    ups = ups if up == "auto" else ups[:1]
    named = [one for one in readings_of(units.items(), ups) if cloth.may_be(one.scale)]
    if (plain := _on_standard(cloth, body, named)) is not None:
        return [replace(plain, sure=_held(cloth, plain))]
    found = _fitted(cloth, body, named)
    enough = [(UNIT_ENOUGH, UNIT_INSIDE), (LOOSE_ENOUGH, LOOSE_INSIDE)]
    fits = any(one.energy < energy and one.inside < inside for one in found for energy, inside in enough)
    if unit == "auto" and not fits:
        sizes = [("free", extent / cloth.extent) for extent in FREE_EXTENTS_M if cloth.may_be(extent / cloth.extent)]
        upright = tuple(one for one in ups if one in ("+y", "+z"))
        found += _fitted(cloth, body, list(readings_of(sizes, upright)))
    found.sort(key=lambda one: (bool(one.fault), one.energy))
    sure = [_sureness(one, found) * (1.0 if number else _held(cloth, one)) for number, one in enumerate(found)]
    return [replace(one, sure=one_sure) for one, one_sure in zip(found, sure, strict=True)]


def the_wearer(mesh: GarmentMesh, body: BodyModel, *, unit: str = "auto", up: str = "auto") -> Wearer:
    """The likeliest body; raises ``MeshError`` where none fits and says which part does not."""
    found = find_wearers(mesh, body, unit=unit, up=up)
    if not found or found[0].fault:
        used = mesh.vertices[np.unique(mesh.faces)]
        extent = " x ".join(f"{length:.4g}" for length in np.ptp(used, axis=0))
        raise MeshError(
            "garment",
            expected="cloth that a human body fits in, in some unit and pose",
            got=f"an extent of {extent}; " + (found[0].fault if found else "no unit makes that a garment"),
            cure="Say which avatar it was modelled on (avatar), its unit (unit) and its up axis (up).",
        )
    return found[0]


class _Cloth:
    """A garment's points on two densities, their normals, its area and extent, in the file's unit."""

    def __init__(self, mesh: GarmentMesh) -> None:
        self.mesh = mesh
        self.area = float(meshes.face_areas(mesh.vertices, mesh.faces).sum())
        self.few = cloth_points(mesh.vertices, mesh.faces, COARSE_COUNT)[0]
        self.points, face = cloth_points(mesh.vertices, mesh.faces, FINE_COUNT)
        wound = np.where(consistent_turn(mesh.faces), -1.0, 1.0)[face]
        self.normals = wound[:, None] * meshes.face_normals(mesh.vertices, mesh.faces)[face]
        self.piece = mesh_graphs.connected_components(mesh.faces, len(mesh.vertices))[mesh.faces[face, 0]]
        self.extent = float(np.ptp(self.points, axis=0).max())
        long = [one for one in open_contours(mesh.vertices, mesh.faces) if one.length_m > LOOP_SHARE * self.extent]
        picked = [one.points[np.linspace(0, len(one.points), LOOP_POINTS, endpoint=False).astype(int)] for one in long]
        self.loops = np.array(picked[:LOOP_COUNT]).reshape(-1, LOOP_POINTS, 3)

    def may_be(self, scale: float) -> bool:
        """Whether it has the extent and the area of a garment in a unit of ``scale`` [m]."""
        return EXTENT_M[0] <= self.extent * scale <= EXTENT_M[1] and self.area * scale**2 >= AREA_MINIMUM

    def contours(self, reading: Reading) -> list[Contour]:
        """Openings that look like a tube's ends, in metres."""
        ends = tube_ends(replace(self.mesh, vertices=reading.apply(self.mesh.vertices)))
        return [one for one in ends if one.length_m > CUFF_M]

    def pierced(self, reading: Reading, joints: np.ndarray) -> tuple[str, ...]:
        """Parts of a body with ``joints`` [m] (24, 3) whose bones go through the cloth."""
        return pierced_parts(self.mesh.vertices, self.mesh.faces, joints @ reading.turn / reading.scale)

    def empty(self, reading: Reading, joints: np.ndarray) -> int:
        """The number of long openings that no bone goes through."""
        return unthreaded(reading.apply(self.loops.reshape(-1, 3)).reshape(self.loops.shape), joints)

    def smallness(self, reading: Reading) -> float:
        return SMALL * max(0.0, float(np.log(SMALL_M2 / (self.area * reading.scale**2))))


@dataclass(frozen=True, eq=False)
class _Guess:
    """The known body ``number`` at ``-move`` [m] in a reading's frame, its energy, and where the file's origin is."""

    reading: Reading
    number: int
    move: np.ndarray
    energy: float
    origin: str


def _guesses(cloth: _Cloth, fields: Sequence[Field], readings: Sequence[Reading]) -> list[_Guess]:
    """Places of the known bodies in every reading, the best of them judged by what they enclose too, best first."""
    places = {reading: _places(cloth, fields, reading) for reading in readings}
    places = {reading: found for reading, found in places.items() if found}

    def judged(guesses: list[_Guess]) -> list[_Guess]:
        found = []
        for one in guesses:
            bones = fields[one.number].bones
            share, nearest = enclosed(one.reading.apply(cloth.points) + one.move, bones)
            odd = ODD_SIDE * _one_sided(bones, nearest)
            found.append(replace(one, energy=one.energy + 1.0 - float(share.mean()) + odd))
        return sorted(found, key=lambda one: one.energy)

    tops = judged([one for found in places.values() for one in found[:PLACES]])
    best = list(dict.fromkeys(one.reading for one in tops))[:READINGS]
    every = judged([one for reading in best for one in places[reading]])[:PIERCED_COUNT]
    for number, one in enumerate(every):
        joints = fields[one.number].bones.joints - one.move
        odd = 0.5 * ODD_PIERCED * len(cloth.pierced(one.reading, joints))
        odd += ODD_EMPTY * cloth.empty(one.reading, joints)
        every[number] = replace(one, energy=one.energy + odd)
    return sorted(every, key=lambda one: one.energy)


def _places(cloth: _Cloth, fields: Sequence[Field], reading: Reading) -> list[_Guess]:
    """The best heights of each known body in a reading, by distances alone."""
    points = reading.apply(cloth.few)
    low, high = points.min(axis=0), points.max(axis=0)
    middle = 0.5 * (low + high)
    weight = np.where(points[:, 1] > high[1] - BAND_M, BAND_WEIGHT, 1.0).astype(np.float32)
    weight /= weight.sum()
    extra = reading.oddness + cloth.smallness(reading)
    found = []
    for number, field in enumerate(fields):
        start = np.array([-middle[0], field.floor_m - 0.06 - low[1], -middle[2]])
        room = field.top_m + 0.2 - (high[1] + start[1])
        if room < -0.5:
            continue
        rises = np.arange(0, max(room, 0.0) / CELL_M + 1, RISE_CELLS).astype(np.int32)
        cost = field.costs(points + start, rises, DEPTH_CELLS, weight)
        best = cost.min(axis=1)
        for rise in np.argsort(best)[:PLACES]:
            move = start + CELL_M * np.array([0, rises[rise], DEPTH_CELLS[cost[rise].argmin()]])
            found.append(_Guess(reading, number, move, float(best[rise]) + extra + KNOWN[number][3] + ODD_ORIGIN, ""))
        for origin, height in (("root", 0.0), ("floor", field.floor_m)):
            move = np.array([0.0, height, 0.0])
            if field.floor_m - 0.1 < low[1] + height and high[1] + height < field.top_m + 0.2:
                cost = float(field.costs(points + move, AT_ONCE, AT_ONCE, weight)[0, 0])
                found.append(_Guess(reading, number, move, cost + extra + KNOWN[number][3], origin))
    return sorted(found, key=lambda one: one.energy)


def _fitted(cloth: _Cloth, body: BodyModel, readings: Sequence[Reading]) -> list[Wearer]:
    """The best guesses, fitted: one for each reading."""
    guesses = _guesses(cloth, known_fields(body), readings)
    kept: list[_Guess] = []
    for one in guesses:
        rivals = [other for other in kept if other.reading == one.reading]
        alike = [other for other in kept if other.reading.unit == one.reading.unit]
        fresh = one.number not in [other.number for other in rivals]
        if fresh and len(rivals) < 3 and (len(alike) < 2 or len(kept) < FINALISTS):
            kept.append(one)
    thin = thin_body(body)
    fields = known_fields(body)
    contours = {reading: cloth.contours(reading) for reading in {one.reading for one in kept}}
    first = [_fit(cloth, thin, contours[one.reading], _Start.of(one, fields[one.number]), FIRST_STEPS) for one in kept]
    best: dict[Reading, Wearer] = {}
    for one in sorted(first, key=lambda one: one.energy):
        best.setdefault(one.reading, one)
    winners = [one for one in best.values() if one.energy < CLEARLY + next(iter(best.values())).energy][:WINNERS]
    last = [_fit(cloth, thin, contours[one.reading], one, LAST_STEPS) for one in winners]
    chosen = [min(pair, key=lambda one: one.energy) for pair in zip(winners, last, strict=True)]
    return [replace(one, body=body) for one in (*chosen, *list(best.values())[len(winners) :])]


def _on_standard(cloth: _Cloth, body: BodyModel, readings: Sequence[Reading]) -> Wearer | None:
    """The standard body in T-pose at the file's origin or on its floor, where cloth goes round it and not into it."""
    thin = thin_body(body)
    found = []
    for reading in readings:
        if reading.front != USUAL_FRONTS.get(reading.up, ("",))[0]:
            continue
        for rise in (0.0, -body.floor_m()):
            parameters = start_parameters(body, 0.0, np.array([0.0, rise, 0.0]))
            one = judge(cloth, reading, thin, parameters, 0.0)
            limits = PLAIN_LIMITS if reading.unit == "m" and reading.up == "+y" and rise == 0.0 else LIMITS
            if (np.array([one.inside, one.open_share, one.energy]) < limits).all():
                found.append(one)
    best = min(found, key=lambda one: one.energy, default=None)
    return None if best is None else replace(best, body=body, fault="")


class _Start(NamedTuple):
    """Where a fit begins; a ``Wearer`` has the same."""

    reading: Reading
    parameters: np.ndarray
    odd_arms: float
    origin: str

    @classmethod
    def of(cls, guess: _Guess, field: Field) -> _Start:
        parameters = np.concatenate([field.parameters[:-3], field.parameters[-3:] - guess.move])
        return cls(guess.reading, parameters, KNOWN[guess.number][3], guess.origin)


def _fit(cloth: _Cloth, body: BodyModel, contours: list[Contour], one: _Start | Wearer, steps: int) -> Wearer:
    """The body fitted to a reading from where ``one`` is, and how well the garment lies on it."""
    reading, start, origin = one.reading, one.parameters, one.origin
    points, normals = reading.apply(cloth.points), cloth.normals @ reading.turn.T
    skin = posed_by(body, start)
    near = KDTree(skin).query(points)[1]
    # By pieces: a wall of a sleeve that lies in the arm, or beyond it, shall come back.
    agreement = np.einsum("nc,nc->n", normals, meshes.vertex_normals(skin, body.faces)[near])
    facing = np.where(np.bincount(cloth.piece, agreement)[cloth.piece] < 0.0, -1.0, 1.0)
    likely = start.copy()
    if origin:
        likely[[-3, -1]] = 0.0
        likely[-2] = 0.0 if origin == "root" else start[-2]
    some = slice(None, None, max(1, len(points) // FIT_COUNT))
    parameters, _ = fit_from(
        body,
        points[some],
        (normals * facing[:, None])[some],
        contours,
        start,
        steps,
        wanted=None,
        likely=likely,
        shape_prior_m=np.resize(SHAPE_PRIOR_M, body.shape_count),
        slack=SLACK,
        place_prior_m=ORIGIN_PRIOR_M[origin],
        sole=int(skin[:, 1].argmin()) if origin == "floor" else None,
    )
    return judge(cloth, reading, body, parameters, one.odd_arms)


def judge(cloth: _Cloth, reading: Reading, body: BodyModel, parameters: np.ndarray, odd_arms: float) -> Wearer:
    """How the cloth lies on the body with ``parameters``, of whose arms the start was as odd as ``odd_arms``."""
    points = reading.apply(cloth.points)
    skin = posed_by(body, parameters)
    far, near = KDTree(skin).query(points)
    along = np.einsum("nc,nc->n", meshes.vertex_normals(skin, body.faces)[near], points - skin[near])
    distance = np.where(far > 2.0 * BAND_LIMIT_M, np.copysign(far, along), along)
    band = points[:, 1] > points[:, 1].max() - BAND_M
    weight = np.where(band, BAND_WEIGHT, 1.0)
    bones = bones_of(joints_of(body, parameters), skin)
    share, nearest = enclosed(points, bones)
    parts = np.array(bones.part)[nearest]
    sleeved = float(np.isin(parts, ("left arm", "right arm")).mean()) > SLEEVE_SHARE
    betas, pose, trans = unpack(body, parameters)
    pierced = cloth.pierced(reading, bones.joints)
    odd = reading.oddness + cloth.smallness(reading) + odd_arms + ODD_PIERCED * len(pierced)
    odd += SHAPE_COST * min(float(((betas[:10] - shape) ** 2).sum()) for shape in map(np.array, SHAPES.values()))
    odd += ODD_SIDE * _one_sided(bones, nearest) + ODD_EMPTY * cloth.empty(reading, bones.joints)
    odd += TURNED_COST * float((pose[UPRIGHT].sum(axis=0) ** 2).sum())
    odd += HEIGHT_COST * ((np.ptp(body.rest_vertices(betas)[:, 1]) - HEIGHT_M) / HEIGHT_SPREAD_M) ** 2
    heights = {"root": abs(trans[1]), "floor": abs(skin[:, 1].min()), "": ORIGIN_M}
    origin = min(heights, key=lambda name: heights[name]) if np.abs(trans[[0, 2]]).max() < ORIGIN_M else ""
    odd += 0.0 if origin else ODD_ORIGIN
    inside, open_share = distance < -DEEP_M, 1.0 - float(share.mean())
    energy = float((point_cost(distance) * weight).sum() / weight.sum()) + open_share + odd
    top = float(np.median(np.abs(distance[band])))
    fault = ""
    if inside.mean() > INSIDE_LIMIT:
        names, counts = np.unique(parts[inside], return_counts=True)
        fault = f"at best the {names[counts.argmax()]} cuts through it ({100.0 * inside.mean():.0f} % lies inside)"
    elif energy > ENERGY_LIMIT:
        fault = f"at best it lies {1e3 * np.abs(distance).mean():.0f} mm from the skin on average"
    elif pierced and inside.mean() > UNIT_INSIDE:
        fault = f"at best the {pierced[0].replace('_', ' ')} goes through the cloth"
    elif open_share > OPEN_LIMIT:
        fault = f"at best {100.0 * open_share:.0f} % of the way round the body is open"
    elif top > BAND_LIMIT_M:
        fault = f"at best its top hangs {1e3 * top:.0f} mm from the skin"
    return Wearer(
        reading, body, parameters, energy, float(inside.mean()), open_share, top, sleeved, fault, odd_arms, origin
    )


def _one_sided(bones: Bones, nearest: np.ndarray) -> float:
    """How much more of the cloth lies on the limbs of one side, as a share."""
    side = np.array([part.startswith("left") - 1.0 * part.startswith("right") for part in bones.part])
    return abs(float(side[nearest].mean()))


def _held(cloth: _Cloth, one: Wearer) -> float:
    """Near 1 where cloth holds its body in its place: the same body higher or lower fits clearly worse."""
    thin, rises = thin_body(one.body), []
    for rise in (-HELD_M, 0.0, HELD_M):
        parameters = one.parameters + np.concatenate([np.zeros(len(one.parameters) - 2), [rise, 0.0]])
        rises.append(judge(cloth, one.reading, thin, parameters, one.odd_arms).energy)
    return float(np.clip((min(rises[0], rises[2]) - rises[1]) / HELD + (HELD_ORIGIN if one.origin else 0.3), 0.3, 1.0))


def _sureness(one: Wearer, found: Sequence[Wearer]) -> float:
    """Near 1 where every other reading fits clearly worse and the cloth lies near the skin."""
    rival = min((other.energy for other in found if other.reading != one.reading), default=np.inf)
    return float(np.clip((rival - one.energy) / RIVAL, 0.05, 1.0) * np.clip(1.2 - one.energy, 0.1, 1.0))
