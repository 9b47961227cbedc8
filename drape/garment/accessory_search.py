"""Who wears a thing that is no cloth, from a file with nothing said: glasses, hats, shoes.

They tell neither height nor pose, and half a person would do for them. But they are of a size, and mostly lie in their
file where a head or feet are, over its root or its floor. What lies there, or is glasses or a shoe by its shape, is
seated on the known body that it is nearest to, and must then be carried by a bone (``accessories``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.garment.accessories import CARRIERS, carriers_of
from drape.garment.contours import Contour, open_contours
from drape.garment.files.mesh import GarmentMesh
from drape.garment.mesh_checks import UNITS_M
from drape.garment.reading_hints import NO_HINTS, ReadingHints
from drape.garment.registration import posed_by
from drape.garment.seats import Seat, are_glasses, is_as_large
from drape.garment.sheets import pieces_of
from drape.garment.wearer_fields import DENSE_COUNT, SHAPES, cloth_points, known_parameters, thin_body
from drape.garment.wearer_reading import USUAL_FRONTS, Reading, WearerCandidate, readings_of
from drape.geometry import meshes

COUNT = 400  # points on an accessory
EXTENT_M = (0.05, 0.8)
FEET = ("ankle", "foot")
# Where accessories are worn: the bones; how far below, above and beside the box of their skin an accessory may lie [m];
# and the least extents that it has across, up and back [m].
PLACES = (
    (("head",), 0.12, 0.3, 0.3, (0.1, 0.02, 0.02)),
    (tuple(f"{side}_{bone}" for side in ("left", "right") for bone in FEET), 0.15, 0.4, 0.12, (0.2, 0.02, 0.17)),
    *((tuple(f"{side}_{bone}" for bone in FEET), 0.15, 0.4, 0.06, (0.06, 0.02, 0.17)) for side in ("left", "right")),
)
HEAD, ONE_FOOT = 0, [2, 3]  # rows of PLACES
FAR_M = 0.1  # mean distance of an accessory from the skin that it is worn on, at most
TRIED = 4  # so many of the likeliest spots are tried
# A shoe's extents [m] across, up and back. Its level faces this near to its lowest point, the sole, have at least this
# share of the area of its box.
SHOE_M, SOLE_M, SOLE_SHARE = ((0.06, 0.14), (0.03, 0.5), (0.18, 0.36)), 0.02, 0.4
TEMPLES_M = 0.08  # glasses without temples, off any face, may be a shirt in another unit
MOST_OPENINGS, OPENING = 2, 0.2  # borders of the largest piece longer than this share of its extent: a shirt has four
IN_PLACE_M = 0.02  # the file's origin at a root or floor, or the shape of glasses, makes up for this distance
SURE, SURE_ANYWHERE = 0.8, 0.4
# A skirt or briefs are as high over their floor as a head is over its root, but have a waist: an opening above such a
# share of them, as long as such a share of the longest. What is as low as a headband may have one too.
WAIST_ABOVE, WAIST_LENGTH, HEADBAND_M = 0.6, 0.3, 0.12
# A hood goes over the crown: around the way up from the head's middle cloth is in such a share of the directions.
CONE, CROWN_SHARE, DIRECTION_RAD, DIRECTIONS = np.cos(np.radians(40.0)), 0.5, 0.15, 600


class _Spot(NamedTuple):
    """A thing at a place of a known body: the ``move`` [m] (3,) of what the ``reading`` has, and how ``far`` [m] it is
    from the skin there; ``origin`` as a ``WearerCandidate`` has it."""

    far: float
    reading: Reading
    shape: str
    move: np.ndarray
    origin: str
    bones: tuple[str, ...]


class _Place(NamedTuple):
    """The box of the skin that a place has, ``low`` and ``high`` [m] (3,), a tree of it, and its number."""

    low: np.ndarray
    high: np.ndarray
    tree: KDTree
    number: int


def accessory_wearer(mesh: GarmentMesh, body: BodyModel, hints: ReadingHints = NO_HINTS) -> WearerCandidate | None:
    """Returns the known body that wears ``mesh`` as a hat, a hood, glasses or shoes, moved to where the mesh is. None
    for other cloth: what is no hood, and is carried by no bone there. ``mesh``: checked, in the frame of its file.
    ``hints``: what was stated of the file."""
    points, face = cloth_points(mesh.vertices, mesh.faces, COUNT)
    areas = meshes.face_areas(mesh.vertices, mesh.faces)
    level = areas.sum() / COUNT * meshes.face_normals(mesh.vertices, mesh.faces)[face]
    likeliest: dict[tuple[Reading, tuple[str, ...]], _Spot] = {}
    for spot in sorted(
        _spots(points, level, body, hints), key=lambda spot: spot.far - (IN_PLACE_M if spot.origin else 0.0)
    ):
        likeliest.setdefault((spot.reading, spot.bones), spot)
    if not likeliest:
        return None
    openings = _openings(mesh)
    likely = [
        spot for spot in likeliest.values() if spot.bones != ("head",) or not _has_waist(mesh, openings, spot.reading)
    ]
    for spot in likely[:TRIED]:
        parameters = known_parameters(body, spot.shape, 0.0, 0.0)
        parameters[-3:] -= spot.move
        sure = SURE if spot.origin else SURE_ANYWHERE
        worn = WearerCandidate(
            spot.reading, body, parameters, spot.far, 0.0, 0.0, spot.far, sleeved=False, origin=spot.origin, sure=sure
        )
        if spot.origin and spot.bones == ("head",) and (hooded := _hooded(mesh, worn, hints)) is not None:
            return hooded
        worn, bones = _seated(mesh, worn, spot.bones)
        if bones and (are_glasses(spot.reading.apply(points)) or len(openings) <= MOST_OPENINGS):
            return worn
    return None


def _hooded(mesh: GarmentMesh, worn: WearerCandidate, hints: ReadingHints) -> WearerCandidate | None:
    """Returns ``worn`` with the front where the hood ``mesh`` is open. None where the mesh does not go over the crown
    of the head, or a bone carries it."""
    skin, reading = posed_by(worn.body, worn.parameters), worn.reading
    head = skin[worn.body.weights.argmax(axis=1) == JOINT_NAMES.index("head")]
    points = cloth_points(mesh.vertices, mesh.faces, DENSE_COUNT)[0]

    def covered(other: Reading, axis: int) -> float:
        away = other.apply(points) - 0.5 * (head.min(axis=0) + head.max(axis=0))
        spread = _directions()[_directions()[:, axis] > CONE]
        far = KDTree(away / np.linalg.norm(away, axis=1, keepdims=True)).query(spread)[0]
        return float((far < DIRECTION_RAD).mean())

    placed = replace(mesh, vertices=reading.apply(mesh.vertices))
    if covered(reading, 1) < CROWN_SHARE or carriers_of(placed, skin, worn.body):
        return None
    fronts = readings_of([(reading.unit, reading.scale)], reading.up, hints.front)
    return replace(worn, reading=min(fronts, key=lambda front: covered(front, 2) + front.oddness))


@lru_cache(maxsize=1)
def _directions() -> np.ndarray:
    """Unit vectors (n, 3), evenly spread."""
    number = np.arange(DIRECTIONS) + 0.5
    height, turn = 1.0 - 2.0 * number / DIRECTIONS, number * np.pi * (1.0 + 5.0**0.5)
    round_m = np.sqrt(1.0 - height**2)
    return np.stack([round_m * np.cos(turn), height, round_m * np.sin(turn)], axis=1)


def seated(mesh: GarmentMesh, wearer: WearerCandidate) -> WearerCandidate:
    """Returns ``wearer``, a body in the frame that its reading gives, moved so that ``mesh``, in the frame of its file,
    sits on its head or its feet as worn. If no bone carries ``mesh``, ``wearer`` is returned as it is."""
    extent = float(np.ptp(mesh.vertices[mesh.faces], axis=(0, 1)).max()) * wearer.reading.scale
    if extent > EXTENT_M[1]:
        return wearer
    placed = replace(mesh, vertices=wearer.reading.apply(mesh.vertices))
    bones = carriers_of(placed, posed_by(wearer.body, wearer.parameters), wearer.body)
    return _seated(mesh, wearer, bones)[0] if bones else wearer


def _seated(
    mesh: GarmentMesh, wearer: WearerCandidate, bones: tuple[str, ...]
) -> tuple[WearerCandidate, tuple[str, ...]]:
    """``wearer`` moved so that the ``mesh`` sits on ``bones``, and the bones that carry it there, none of cloth."""
    placed = replace(mesh, vertices=wearer.reading.apply(mesh.vertices))
    skin, parameters = posed_by(wearer.body, wearer.parameters), wearer.parameters.copy()
    way = Seat(skin, wearer.body).way(cloth_points(placed.vertices, mesh.faces, COUNT)[0], bones[0])
    way[0] = way[0] if len(bones) == 1 else 0.0  # a pair stays in the middle
    parameters[-3:] -= way
    return replace(wearer, parameters=parameters), carriers_of(placed, skin - way, wearer.body)


def _openings(mesh: GarmentMesh) -> list[Contour]:
    """The long openings of the largest piece, the longest first."""
    largest = mesh.faces[pieces_of(mesh.vertices, mesh.faces)[0] == 0]
    least = OPENING * float(np.ptp(mesh.vertices[largest], axis=(0, 1)).max())
    return [one for one in open_contours(mesh.vertices, largest) if one.length_m > least]


def _has_waist(mesh: GarmentMesh, openings: list[Contour], reading: Reading) -> bool:
    """Whether ``mesh`` is higher than a headband, with a wide one of its long ``openings`` at its upper end."""
    height = reading.apply(mesh.vertices[np.unique(mesh.faces)])[:, 1]
    above = height.min() + WAIST_ABOVE * np.ptp(height)
    wide = [one.points for one in openings if one.length_m > WAIST_LENGTH * openings[0].length_m]
    return np.ptp(height) > HEADBAND_M and any(reading.apply(points)[:, 1].min() > above for points in wide)


def _spots(points: np.ndarray, normals: np.ndarray, body: BodyModel, hints: ReadingHints) -> Iterator[_Spot]:
    """Where the thing with ``points`` (N, 3) of the file may be worn, in every reading; ``normals`` (N, 3) are as long
    as the area of each."""
    units = UNITS_M.items() if hints.unit is None else (hints.unit,)
    for reading in readings_of(units, hints.up, hints.front):
        at = reading.apply(points)
        extent = np.ptp(at, axis=0)
        if not EXTENT_M[0] <= extent.max() <= EXTENT_M[1] or (hints.up is None and reading.up not in ("+y", "+z")):
            continue
        usual = hints.front is not None or reading.front in USUAL_FRONTS.get(reading.up, ())
        shapes: list[int] = []
        if usual and extent[2] > TEMPLES_M and are_glasses(at):
            shapes = [HEAD]
        elif _is_shoe(at, reading.scale**2 * normals @ reading.turn.T):
            shapes = ONE_FOOT
        for shape in SHAPES:
            places, floor_m = _places(body, shape)
            for origin, height in (("root", 0.0), ("floor", floor_m)) if usual else ():
                move = np.array([0.0, height, 0.0])
                far, number = min((_worn_far(at + move, place), place.number) for place in places)
                if far < FAR_M:
                    yield _Spot(far, reading, shape, move, origin, _carriers(number))
            for place in (places[number] for number in shapes):
                move = 0.5 * (place.low + place.high - at.min(axis=0) - at.max(axis=0))
                move[1] = place.high[1] - at[:, 1].max() if place.number == HEAD else place.low[1] - at[:, 1].min()
                far = _distance(at + move, place) - (IN_PLACE_M if place.number == HEAD else 0.0)
                yield _Spot(far, reading, shape, move, "", _carriers(place.number))


def _carriers(number: int) -> tuple[str, ...]:
    return tuple(bone for bone in PLACES[number][0] if bone in CARRIERS)


def _worn_far(points: np.ndarray, place: _Place) -> float:
    """How far [m] the ``points`` [m] (N, 3) of what is worn at ``place`` are from the skin, infinite elsewhere."""
    _, below, above, beside, least = PLACES[place.number]
    low, high = points.min(axis=0), points.max(axis=0)
    room = np.array([[beside, below, beside], [beside, above, beside]])
    held = (low >= place.low - room[0]).all() and (high <= place.high + room[1]).all()
    held = held and (high - low >= least).all() and low[1] < place.high[1] and high[1] > place.low[1]
    return _distance(points, place) if held else np.inf


def _distance(points: np.ndarray, place: _Place) -> float:
    """The mean distance [m] of ``points`` (N, 3) from the skin of ``place``, and at feet of that from them too: shoes
    are all round their feet."""
    far = float(place.tree.query(points)[0].mean())
    return far if place.number == HEAD else 0.5 * (far + float(KDTree(points).query(place.tree.data)[0].mean()))


def _is_shoe(points: np.ndarray, normals: np.ndarray) -> bool:
    if not is_as_large(points, SHOE_M):
        return False
    extent = np.ptp(points, axis=0)
    level = np.abs(normals[:, 1]) * (np.abs(normals[:, 1]) > 0.9 * np.linalg.norm(normals, axis=1))
    return bool(level[points[:, 1] < points[:, 1].min() + SOLE_M].sum() > SOLE_SHARE * extent[0] * extent[2])


@lru_cache(maxsize=16)
def _places(body: BodyModel, shape: str) -> tuple[list[_Place], float]:
    """The ``PLACES`` of a known shape, and how far below its root it stands [m], as a negative number."""
    thin = thin_body(body)
    skin, bone = posed_by(thin, known_parameters(body, shape, 0.0, 0.0)), thin.weights.argmax(axis=1)
    places = []
    for number, (bones, *_) in enumerate(PLACES):
        own = skin[np.isin(bone, [JOINT_NAMES.index(name) for name in bones])]
        places.append(_Place(own.min(axis=0), own.max(axis=0), KDTree(own), number))
    return places, float(skin[:, 1].min())
