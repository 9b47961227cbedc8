"""Who wore a garment that came with nothing said: its unit, axes and place, and the arms and shape of the body in it.

Every reading of the file (unit, up axis, facing) is laid over the known bodies at every height, and judged by cloth in
the skin, cloth far from it and bones that cloth does not go round (``wearer_guess``). The best are fitted: shape, pose
and place of the standard body by ``inside.fit_from``. Where no unit fits, sizes between the units are tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape import forked
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.errors import MeshError
from drape.garment.caps import without_pits
from drape.garment.contours import Contour
from drape.garment.files.mesh import GarmentMesh
from drape.garment.inside import fit_from
from drape.garment.mesh_checks import UNITS_M
from drape.garment.reading_hints import NO_HINTS, ReadingHints
from drape.garment.registration import FREE_JOINTS, posed_by, posed_normals, start_parameters
from drape.garment.searched_cloth import SearchedCloth
from drape.garment.wearer_fields import KNOWN, Field, known_fields, thin_body
from drape.garment.wearer_guess import Guess, guesses_of
from drape.garment.wearer_judge import UNIT_INSIDE, judge
from drape.garment.wearer_reading import USUAL_FRONTS, Reading, WearerCandidate, readings_of

FREE_EXTENTS_M = 0.3 * 1.2 ** np.arange(10)  # extents that are tried where no unit fits
FIT_COUNT = 500  # points on the cloth
FINALISTS, RIVALS, WINNERS = 6, 2, 3
CLEARLY, WORSE = 0.1, 0.03  # a fit worse by the first after a few steps stays worse; by the second it went astray
FIRST_STEPS, LAST_STEPS, FREE_STEPS, LOCK = 5, 15, 12, 0.5
# Arms this far below the horizontal are tried too, at this cost.
ARM_LIFTS_RAD, ODD_ARMS = (1.5, 1.35, 1.1, 0.85, 0.6, 0.3, -0.4), 0.02
# Arms in front of the body are tried where straight ones have more energy; upper arms turn in by BENT_INWARD.
BENT_ENERGY, BENT_LIFTS_RAD, BENDS_RAD, BENT_INWARD = 0.25, (1.35, 1.0, 0.6), (0.8, 1.5), 0.2
SLACK = 0.1  # wide legs and hems would slide up to where the body is wider; what carries a garment is its top
# Root of the cost of a metre from the likely place, if the file's origin is at the root, on the floor, or anywhere. The
# roots of other makers' bodies are higher or lower.
ORIGIN_PRIOR_M = {"root": np.array([0.2, 0.06, 0.2]), "floor": np.array([0.2, 1e-4, 0.2]), "": np.full(3, 1e-4)}
UNIT_ENOUGH = 0.3  # energy up to which a unit is accepted
LOOSE_INSIDE, LOOSE_ENOUGH = 0.015, 0.35  # cloth inside and energy of capes and other cloth that stands off
# Cloth inside, open share and energy of a garment on the standard body at its origin, and of one in metres, y up.
LIMITS, PLAIN_LIMITS = (0.005, 0.2, 0.6), (0.002, 0.45, 0.8)
SHAPE_PRIOR_M = np.array([5.0e-3, *[2.5e-3] * 9])  # root of the cost of each beta; the first one is the height
HELD_M, HELD = 0.06, 0.12  # a garment that does not slide gains this energy when moved so far
HELD_ORIGIN = 0.5  # the file's origin counts as much
AS_GOOD, SLID_M = 0.02, 0.08  # bodies that fit as well, so far apart, leave no place to be sure of
RIVAL = 0.15  # a reading that is worse by this leaves no doubt
NEARLY, APART_M, MOST_OTHERS = 0.05, 0.06, 2  # worse by less is nearly as likely; so far off it is another body


def find_wearers(mesh: GarmentMesh, body: BodyModel, hints: ReadingHints = NO_HINTS) -> list[WearerCandidate]:
    """Returns the bodies that may have worn ``mesh``, a checked mesh in the frame of its file, the likeliest first;
    empty if no unit makes it as large as a garment. ``hints``, what was stated of the file, limits the readings that
    are tried. Bodies of one reading stand at least ``APART_M`` apart. The first has its ``others``, which are nearly as
    likely."""
    cloth = SearchedCloth(mesh)
    units = UNITS_M.items() if hints.unit is None else (hints.unit,)
    named = [reading for reading in readings_of(units, hints.up, hints.front) if cloth.may_be(reading.scale)]
    usual = [reading for reading in named if hints.front or reading.front == USUAL_FRONTS.get(reading.up, ("",))[0]]
    if (plain := _on_standard(cloth, body, usual)) is not None:
        return [replace(plain, sure=_held(cloth, plain))]
    guesses = guesses_of(cloth, known_fields(body), named)
    if guesses and not (keep := _without_pits(mesh, known_fields(body), guesses[0])).all():
        return find_wearers(mesh.take_faces(keep), body, hints)
    fits = _fitted(cloth, body, guesses)
    enough = [(UNIT_ENOUGH, UNIT_INSIDE), (LOOSE_ENOUGH, LOOSE_INSIDE)]
    good = any(not fit.fault and fit.energy < e and fit.inside < share for fit in fits for e, share in enough)
    if hints.unit is None and not good:
        sizes = [("free", extent / cloth.extent) for extent in FREE_EXTENTS_M if cloth.may_be(extent / cloth.extent)]
        free = [r for r in readings_of(sizes, hints.up, hints.front) if hints.up or r.up in ("+y", "+z")]
        fits += _fitted(cloth, body, guesses_of(cloth, known_fields(body), free))
    least = {fit.reading: min(_rank(other) for other in fits if other.reading == fit.reading) for fit in fits}
    fits.sort(key=lambda fit: (least[fit.reading], bool(fit.fault), fit.among))
    sure = [_sureness(fit, fits) * (1.0 if number else _held(cloth, fit)) for number, fit in enumerate(fits)]
    fits = [replace(fit, sure=share) for fit, share in zip(fits, sure, strict=True)]
    return [replace(fits[0], others=_others(cloth, fits)), *fits[1:]] if fits else []


def _rank(fit: WearerCandidate) -> tuple[bool, float]:
    return bool(fit.fault), fit.rank


def _others(cloth: SearchedCloth, fits: Sequence[WearerCandidate]) -> tuple[WearerCandidate, ...]:
    """Those of ``fits``, best first, that are nearly as likely as the first, and distinctly other bodies."""
    bodies, least = [fits[0]], min(fit.rank for fit in fits if fit.reading == fits[0].reading)
    for fit in fits[1:]:
        alike = fit.reading == fits[0].reading
        worse = fit.among - fits[0].among if alike else fit.rank - least
        near = not fit.fault and worse < NEARLY
        if near and len(bodies) <= MOST_OTHERS and all(_apart_m(cloth, fit, other) > APART_M for other in bodies):
            bodies.append(fit)
    return tuple(bodies[1:])


def _apart_m(cloth: SearchedCloth, first: WearerCandidate, second: WearerCandidate) -> float:
    """How far [m] the skin under the cloth is from where ``second`` has the same skin."""
    thin = thin_body(first.body)
    skin, there = (posed_by(thin, candidate.parameters) for candidate in (first, second))
    under = KDTree(skin).query(first.reading.apply(cloth.points))[1]
    moved = first.reading.apply(there[under] @ second.reading.turn / second.reading.scale)
    return float(np.linalg.norm(moved - skin[under], axis=1).mean())


def the_wearer(mesh: GarmentMesh, body: BodyModel, hints: ReadingHints = NO_HINTS) -> WearerCandidate:
    """Returns the likeliest body that has worn ``mesh``, a checked mesh in the frame of its file. Raises ``MeshError``
    where none fits; it says which part does not."""
    wearers = find_wearers(mesh, body, hints)
    if not wearers or wearers[0].fault:
        used = mesh.vertices[np.unique(mesh.faces)]
        extent = " x ".join(f"{length:.4g}" for length in np.ptp(used, axis=0))
        cure = "Say which avatar it was modelled on (avatar), its unit (unit) and its up axis (up)."
        if hints != NO_HINTS:
            cure = "Leave out what was said of the file (unit, up, facing), or say which avatar it was modelled on."
        raise MeshError(
            "garment",
            expected="cloth that a human body fits in, in some unit and pose",
            got=f"an extent of {extent}; " + (wearers[0].fault if wearers else "no unit makes that a garment"),
            cure=cure,
        )
    return wearers[0]


def _without_pits(mesh: GarmentMesh, fields: Sequence[Field], guess: Guess) -> np.ndarray:
    """Which faces (F,) are of no pit by the bones of a ``guess``: fits would keep a neck out of a closed collar."""
    points = guess.reading.apply(mesh.vertices)
    return without_pits(points, mesh.faces, fields[guess.number].bones.joints - guess.move)


def _fitted(cloth: SearchedCloth, body: BodyModel, guesses: Sequence[Guess]) -> list[WearerCandidate]:
    """The best of the ``guesses``, fitted; those of one reading stand ``APART_M`` apart."""
    finalists: list[Guess] = []
    for guess in guesses:
        rivals = [other for other in finalists if other.reading == guess.reading]
        alike = [other for other in finalists if other.reading.unit == guess.reading.unit]
        fresh = guess.number not in [other.number for other in rivals]
        if fresh and len(rivals) < 3 and (len(alike) < 2 or len(finalists) < FINALISTS):
            finalists.append(guess)
    thin, fields = thin_body(body), known_fields(body)
    read = list(dict.fromkeys(guess.reading for guess in finalists))
    contours = dict(zip(read, forked.each(cloth.contours, read), strict=True))
    starts = [_Start.of(guess, fields[guess.number]) for guess in finalists]
    tops = {start.reading: start for start in reversed(starts)}
    starts += [_with_arms(cloth, thin, start) for start in tops.values()]
    first = forked.each(lambda start: _fit(cloth, thin, contours[start.reading], start, FIRST_STEPS), starts)
    first = sorted(_on(thin, first), key=lambda fit: fit.rank)
    likely: list[WearerCandidate] = []
    for fit in first:
        rivals = [other for other in likely if other.reading == fit.reading]
        if fit.rank < CLEARLY + first[0].rank and len(rivals) < RIVALS and len(likely) < WINNERS:
            likely.append(fit)
    chosen = _on(thin, forked.each(lambda fit: _refined(cloth, thin, contours[fit.reading], fit), likely))
    rest = [fit for fit in first if fit not in likely]
    apart: list[WearerCandidate] = []
    for fit in (*sorted(chosen, key=lambda fit: fit.among), *rest):
        if all(fit.reading != other.reading or _apart_m(cloth, fit, other) > APART_M for other in apart):
            alike = [other for other in chosen if other.reading == fit.reading]
            as_good = [other for other in alike if other.among < fit.among + AS_GOOD]
            slid = max([_apart_m(cloth, fit, other) for other in as_good], default=0.0)
            apart.append(replace(fit, body=body, slid_m=slid))
    return apart


def _on(body: BodyModel, fits: Sequence[WearerCandidate]) -> list[WearerCandidate]:
    """``fits`` on ``body`` itself, of which those from other processes have a copy."""
    return [replace(fit, body=body) for fit in fits]


def _refined(cloth: SearchedCloth, body: BodyModel, contours: list[Contour], fit: WearerCandidate) -> WearerCandidate:
    """``fit`` after more steps, the last of them without ``contours``.

    The middle of a sleeve's or an armhole's rim is below the bone: that leads arms into sleeves, and no farther.
    """
    led = min(fit, _fit(cloth, body, contours, fit, LAST_STEPS), key=lambda refined: refined.energy)
    free = _fit(cloth, body, [], led, FREE_STEPS, 0.0 if led.origin == "floor" else LOCK)
    return free if free.energy < led.energy + WORSE else led


def _on_standard(cloth: SearchedCloth, body: BodyModel, readings: Sequence[Reading]) -> WearerCandidate | None:
    """The standard body in T-pose at the file's origin or on its floor, where cloth goes round it and not into it."""
    thin = thin_body(body)
    starts = [(reading, rise) for reading in readings for rise in (0.0, -body.floor_m())]

    def judged(start: tuple[Reading, float]) -> WearerCandidate:
        return judge(cloth, start[0], thin, start_parameters(body, 0.0, np.array([0.0, start[1], 0.0])), 0.0)

    fits = []
    for (reading, rise), fit in zip(starts, forked.each(judged, starts), strict=True):
        limits = PLAIN_LIMITS if reading.unit == "m" and reading.up == "+y" and rise == 0.0 else LIMITS
        if (np.array([fit.inside, fit.open_share, fit.energy]) < limits).all():
            fits.append(fit)
    best = min(fits, key=lambda fit: fit.energy, default=None)
    return None if best is None else replace(best, body=body, fault="")


class _Start(NamedTuple):
    """Where a fit begins; a ``WearerCandidate`` has the same."""

    reading: Reading
    parameters: np.ndarray
    odd_arms: float
    origin: str

    @classmethod
    def of(cls, guess: Guess, field: Field) -> _Start:
        parameters = np.concatenate([field.parameters[:-3], field.parameters[-3:] - guess.move])
        return cls(guess.reading, parameters, KNOWN[guess.number][3], guess.origin)


def _with_arms(cloth: SearchedCloth, body: BodyModel, start: _Start) -> _Start:
    """``start`` with the arms that fit the cloth best: straight ones, or bent ones where straight ones lie badly."""
    straight = [_armed(body, start, lift, 0.0) for lift in ARM_LIFTS_RAD]
    energy = forked.each(lambda other: judge(cloth, other.reading, body, other.parameters, 0.0), straight)
    best = min(range(len(straight)), key=lambda number: energy[number].energy)
    if not energy[best].sleeved or energy[best].energy < BENT_ENERGY:
        return straight[best]
    bent = [_armed(body, start, lift, bend) for lift in BENT_LIFTS_RAD for bend in BENDS_RAD]
    lower = forked.each(lambda other: judge(cloth, other.reading, body, other.parameters, 0.0).energy, bent)
    return [straight[best], *bent][int(np.argmin([energy[best].energy, *lower]))]


def _armed(body: BodyModel, start: _Start, lift_rad: float, bend_rad: float) -> _Start:
    """``start`` with arms ``lift_rad`` below the horizontal and elbows bent by ``bend_rad``, forward, then inward."""
    parameters = start.parameters.copy()
    arms = slice(body.shape_count, -3)
    parameters[arms] = start_parameters(body, lift_rad, np.zeros(3))[arms]
    for side, sign in (("left", -1.0), ("right", 1.0)):
        for joint, share in (("shoulder", BENT_INWARD), ("elbow", 1.0)):
            number = FREE_JOINTS.index(JOINT_NAMES.index(f"{side}_{joint}"))
            parameters[body.shape_count + 3 * number + 1] = share * sign * bend_rad
    return start._replace(parameters=parameters, odd_arms=ODD_ARMS)


def _fit(
    cloth: SearchedCloth,
    body: BodyModel,
    contours: list[Contour],
    begin: _Start | WearerCandidate,
    steps: int,
    lock: float = 0.0,
) -> WearerCandidate:
    """The body fitted to a reading from where ``begin`` is, and how well the garment lies on it."""
    reading, start, origin = begin.reading, begin.parameters, begin.origin
    points, normals = reading.apply(cloth.points), cloth.normals @ reading.turn.T
    skin = posed_by(body, start)
    near = KDTree(skin).query(points)[1]
    # Normals are turned by whole pieces, so that a sleeve's wall in the arm, or beyond it, comes back.
    agreement = np.einsum("nc,nc->n", normals, posed_normals(body, skin)[near])
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
        likely=likely,
        shape_prior_m=np.resize(SHAPE_PRIOR_M, body.shape_count),
        slack=SLACK,
        place_prior_m=ORIGIN_PRIOR_M[origin],
        sole=int(skin[:, 1].argmin()) if origin == "floor" else None,
        lock=lock,
    )
    return judge(cloth, reading, body, parameters, begin.odd_arms)


def _held(cloth: SearchedCloth, fit: WearerCandidate) -> float:
    """Near 1 where cloth holds its body in its place: the same body higher or lower fits clearly worse."""
    thin, rises = thin_body(fit.body), []
    for rise in (-HELD_M, 0.0, HELD_M):
        parameters = fit.parameters + np.concatenate([np.zeros(len(fit.parameters) - 2), [rise, 0.0]])
        rises.append(judge(cloth, fit.reading, thin, parameters, fit.odd_arms).energy)
    held = (min(rises[0], rises[2]) - rises[1]) / HELD + (HELD_ORIGIN if fit.origin else 0.3)
    return float(np.clip(held, 0.3, 1.0) * np.clip(1.0 - fit.slid_m / SLID_M, 0.3, 1.0))


def _sureness(fit: WearerCandidate, fits: Sequence[WearerCandidate]) -> float:
    """Near 1 where every other reading fits clearly worse and the cloth lies near the skin."""
    rival = min((other.rank for other in fits if other.reading != fit.reading), default=np.inf)
    return float(np.clip((rival - fit.rank) / RIVAL, 0.05, 1.0) * np.clip(1.2 - fit.energy, 0.1, 1.0))
