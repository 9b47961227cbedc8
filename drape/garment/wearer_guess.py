"""Guesses at who wore a garment: known bodies at every height in every reading of its file, judged by distances alone.

The best are judged by what they enclose and by bones that the cloth is not open for, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drape import forked
from drape.garment.searched_cloth import SearchedCloth
from drape.garment.wearer_fields import CELL_M, KNOWN, Field, enclosed
from drape.garment.wearer_judge import (
    BAND_M,
    BAND_WEIGHT,
    HANGING_OVER_ARMS,
    ODD_EMPTY,
    ODD_ORIGIN,
    ODD_PIERCED,
    ODD_PLACE,
    ODD_SIDE,
    misplaced,
    one_sided,
)
from drape.garment.wearer_reading import Reading

RISE_CELLS, DEPTH_CELLS = 2, np.arange(-4, 5, 2, dtype=np.int32)
PLACES, READINGS, PIERCED_COUNT = 2, 8, 40
FAIR = 0.35  # units whose best guess is worse by less are tried too: guesses know little of cloth that hangs far away
AT_ONCE = np.zeros(1, dtype=np.int32)


@dataclass(frozen=True, eq=False)
class Guess:
    """A guess at who wore a garment, in one ``reading`` of its file: the body ``number`` of ``KNOWN``, when the cloth
    is moved by ``move`` [m] (3,) onto it. ``energy``: what that costs, without unit; less is likelier. ``origin``: the
    file's origin is at the body's "root" or "floor", or elsewhere ("")."""

    reading: Reading
    number: int
    move: np.ndarray
    energy: float
    origin: str


def guesses_of(cloth: SearchedCloth, fields: Sequence[Field], readings: Sequence[Reading]) -> list[Guess]:
    """Returns the best guesses at the body in ``cloth``, the likeliest first: known bodies, each at several places, in
    ``readings``. ``fields``: what ``known_fields`` returns. All guesses are ranked by distances from the skin. The best
    of them are also ranked by how far the cloth goes round the bones, by bones that go through it, and by long openings
    without a bone; these are returned."""
    laid = forked.each(lambda reading: _over_arms(cloth, fields, reading) + _places(cloth, fields, reading), readings)
    places = {reading: guesses for reading, guesses in zip(readings, laid, strict=True) if guesses}

    def judged(guess: Guess) -> Guess:
        bones = fields[guess.number].bones
        points = guess.reading.apply(cloth.points) + guess.move
        share, nearest = enclosed(points, bones)
        odd = ODD_SIDE * one_sided(bones, nearest) + ODD_PLACE * misplaced(points, bones, nearest, cloth.piece)
        return replace(guess, energy=guess.energy + 1.0 - float(share.mean()) + odd)

    def threaded(guess: Guess) -> Guess:
        joints = fields[guess.number].bones.joints - guess.move
        odd = 0.5 * ODD_PIERCED * len(cloth.pierced(guess.reading, joints))
        return replace(guess, energy=guess.energy + odd + ODD_EMPTY * cloth.empty(guess.reading, joints))

    def sorted_by(known: Callable[[Guess], Guess], guesses: list[Guess]) -> list[Guess]:
        return sorted(forked.each(known, guesses), key=lambda guess: guess.energy)

    tops = sorted_by(judged, [guess for guesses in places.values() for guess in guesses[:PLACES]])
    best = list(dict.fromkeys(guess.reading for guess in tops))
    units = {reading.unit for reading in best[:READINGS]}
    best = best[:READINGS] + [reading for reading in best[READINGS:] if reading.unit not in units]
    every = sorted_by(judged, [guess for reading in best for guess in places[reading]])
    shown = {guess.reading.unit for guess in every[:PIERCED_COUNT]}
    fair = [g for g in every if g.energy < every[0].energy + FAIR and g.reading.unit not in shown]
    by_unit = {guess.reading.unit: guess for guess in reversed(fair)}
    return sorted_by(threaded, every[:PIERCED_COUNT] + list(by_unit.values()))


def _places(cloth: SearchedCloth, fields: Sequence[Field], reading: Reading) -> list[Guess]:
    """The best heights of each known body in a reading, by distances alone."""
    points = reading.apply(cloth.few)
    low, high = points.min(axis=0), points.max(axis=0)
    weight = np.where(points[:, 1] > high[1] - BAND_M, BAND_WEIGHT, 1.0).astype(np.float32)
    weight /= weight.sum()
    extra = reading.oddness + cloth.oddness(reading)
    guesses = []
    for number, field in enumerate(fields):
        start, rises = _rises(field, low, high)
        if not len(rises):
            continue
        cost = field.costs(points + start, rises, DEPTH_CELLS, weight)
        best = cost.min(axis=1)
        for rise in np.argsort(best)[:PLACES]:
            move = start + CELL_M * np.array([0, rises[rise], DEPTH_CELLS[cost[rise].argmin()]])
            guesses.append(Guess(reading, number, move, float(best[rise]) + extra + KNOWN[number][3] + ODD_ORIGIN, ""))
        for origin, height in (("root", 0.0), ("floor", field.floor_m)):
            move = np.array([0.0, height, 0.0])
            if field.floor_m - 0.1 < low[1] + height and high[1] + height < field.top_m + 0.2:
                cost = float(field.costs(points + move, AT_ONCE, AT_ONCE, weight)[0, 0])
                guesses.append(Guess(reading, number, move, cost + extra + KNOWN[number][3], origin))
    return sorted(guesses, key=lambda one: one.energy)


def _over_arms(cloth: SearchedCloth, fields: Sequence[Field], reading: Reading) -> list[Guess]:
    """The best place of a body whose arms the cloth covers without sleeves, by what does not hang from them: at most
    one, in a reading that is usual."""
    points, guesses = reading.apply(cloth.few), []
    low, high = points.min(axis=0), points.max(axis=0)
    wall = 1.0 - np.abs(cloth.few_normals @ reading.turn[1])
    weight = np.where(points[:, 1] > high[1] - BAND_M, BAND_WEIGHT, 1.0 - HANGING_OVER_ARMS * wall)
    weight = (weight / len(weight)).astype(np.float32)
    for number, field in enumerate(fields if reading.unit != "free" and not reading.oddness else ()):
        start, rises = _rises(field, low, high)
        if not len(rises):
            continue
        cost = field.costs(points + start, rises, DEPTH_CELLS, weight)
        rise, depth = np.unravel_index(cost.argmin(), cost.shape)
        move = start + CELL_M * np.array([0, rises[rise], DEPTH_CELLS[depth]])
        if cloth.covers(reading, field.bones, move=move):
            energy = float(cost[rise, depth]) + cloth.oddness(reading) + KNOWN[number][3] + ODD_ORIGIN
            guesses.append(Guess(reading, number, move, energy, ""))
    return sorted(guesses, key=lambda one: one.energy)[:1]


def _rises(field: Field, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where cloth between the corners ``low`` and ``high`` [m] (3,) begins to rise along a body, as a move (3,), and
    the cells (R,) by which it rises; none where it is too high for the body."""
    middle = 0.5 * (low + high)
    start = np.array([-middle[0], field.floor_m - 0.06 - low[1], -middle[2]])
    room = field.top_m + 0.2 - (high[1] + start[1])
    count = max(room, 0.0) / CELL_M + 1 if room >= -0.5 else 0
    return start, np.arange(0, count, RISE_CELLS).astype(np.int32)
