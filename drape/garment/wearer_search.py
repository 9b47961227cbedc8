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

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.errors import MeshError
from drape.forked import each
from drape.garment.caps import without_pits
from drape.garment.contours import Contour
from drape.garment.files.mesh import GarmentMesh
from drape.garment.inside import fit_from
from drape.garment.mesh_checks import UNITS_M
from drape.garment.registration import FREE_JOINTS, posed_by, posed_normals, start_parameters
from drape.garment.searched_cloth import SearchedCloth
from drape.garment.told_reading import NOTHING_TOLD, ToldReading
from drape.garment.wearer_fields import KNOWN, Field, known_fields, thin_body
from drape.garment.wearer_guess import Guess, guesses_of
from drape.garment.wearer_judge import UNIT_INSIDE, judge
from drape.garment.wearer_reading import USUAL_FRONTS, Reading, WearerCandidate, readings_of

FREE_EXTENTS_M = 0.3 * 1.2 ** np.arange(10)  # tried where no unit fits
FIT_COUNT = 500  # points on the cloth
FINALISTS, RIVALS, WINNERS = 6, 2, 3
CLEARLY, WORSE = 0.1, 0.03  # a fit that is worse by this after a few steps stays worse; one that went astray
FIRST_STEPS, LAST_STEPS, FREE_STEPS, LOCK = 5, 15, 12, 0.5
# Arms that hang so far below the horizontal are tried too, at such a cost.
ARM_LIFTS_RAD, ODD_ARMS = (1.5, 1.35, 1.1, 0.85, 0.6, 0.3, -0.4), 0.02
# Arms before the body are asked for where straight ones lie so badly in sleeves; upper arms turn in by such a share.
BENT_ENERGY, BENT_LIFTS_RAD, BENDS_RAD, BENT_INWARD = 0.25, (1.35, 1.0, 0.6), (0.8, 1.5), 0.2
SLACK = 0.1  # wide legs and hems would slide up to where the body is wider; what carries a garment is its top
# What a metre from its place is worth, where the file's origin is at the root, on the floor, or anywhere. Roots are
# higher or lower in other makers' bodies.
ORIGIN_PRIOR_M = {"root": np.array([0.2, 0.06, 0.2]), "floor": np.array([0.2, 1e-4, 0.2]), "": np.full(3, 1e-4)}
UNIT_ENOUGH = 0.3  # energy up to which a unit is meant
LOOSE_INSIDE, LOOSE_ENOUGH = 0.015, 0.35  # cloth inside and energy of capes and other cloth that stands off
# Cloth inside, open share and energy of a garment on the standard body at its origin, and of one in metres, y up.
LIMITS, PLAIN_LIMITS = (0.005, 0.2, 0.6), (0.002, 0.45, 0.8)
SHAPE_PRIOR_M = np.array([5.0e-3, *[2.5e-3] * 9])  # of the betas in a fit: the first one is the height
HELD_M, HELD = 0.06, 0.12  # moved so far up or down, the energy rises by this where a garment does not slide;
HELD_ORIGIN = 0.5  # the file's origin is as good a sign
AS_GOOD, SLID_M = 0.02, 0.08  # bodies that fit as well, so far apart, leave no place to be sure of
RIVAL = 0.15  # a reading that is worse by this leaves no doubt
NEARLY, APART_M, MOST_OTHERS = 0.05, 0.06, 2  # worse by less is nearly as likely; so far off it is another body


def find_wearers(mesh: GarmentMesh, body: BodyModel, told: ToldReading = NOTHING_TOLD) -> list[WearerCandidate]:
    """The bodies that may have worn ``mesh``, best first, in every reading that what is ``told`` allows.

    Those of one reading stand ``APART_M`` apart. The first has its ``others``, which are nearly as likely.
    """
    cloth = SearchedCloth(mesh)
    units = UNITS_M.items() if told.unit is None else (told.unit,)
    named = [one for one in readings_of(units, told.up, told.front) if cloth.may_be(one.scale)]
    usual = [one for one in named if told.front or one.front == USUAL_FRONTS.get(one.up, ("",))[0]]
    if (plain := _on_standard(cloth, body, usual)) is not None:
        return [replace(plain, sure=_held(cloth, plain))]
    guesses = guesses_of(cloth, known_fields(body), named)
    if guesses and not (keep := _without_pits(mesh, known_fields(body), guesses[0])).all():
        return find_wearers(mesh.take_faces(keep), body, told)
    found = _fitted(cloth, body, guesses)
    enough = [(UNIT_ENOUGH, UNIT_INSIDE), (LOOSE_ENOUGH, LOOSE_INSIDE)]
    fits = any(not one.fault and one.energy < e and one.inside < share for one in found for e, share in enough)
    if told.unit is None and not fits:
        sizes = [("free", extent / cloth.extent) for extent in FREE_EXTENTS_M if cloth.may_be(extent / cloth.extent)]
        free = [one for one in readings_of(sizes, told.up, told.front) if told.up or one.up in ("+y", "+z")]
        found += _fitted(cloth, body, guesses_of(cloth, known_fields(body), free))
    least = {one.reading: min(_rank(other) for other in found if other.reading == one.reading) for one in found}
    found.sort(key=lambda one: (least[one.reading], bool(one.fault), one.among))
    sure = [_sureness(one, found) * (1.0 if number else _held(cloth, one)) for number, one in enumerate(found)]
    found = [replace(one, sure=one_sure) for one, one_sure in zip(found, sure, strict=True)]
    return [replace(found[0], others=_others(cloth, found)), *found[1:]] if found else []


def _rank(one: WearerCandidate) -> tuple[bool, float]:
    return bool(one.fault), one.rank


def _others(cloth: SearchedCloth, found: Sequence[WearerCandidate]) -> tuple[WearerCandidate, ...]:
    """Those of ``found``, best first, that are nearly as likely as the first, and distinctly other bodies."""
    kept, least = [found[0]], min(one.rank for one in found if one.reading == found[0].reading)
    for one in found[1:]:
        alike = one.reading == found[0].reading
        worse = one.among - found[0].among if alike else one.rank - least
        near = not one.fault and worse < NEARLY
        if near and len(kept) <= MOST_OTHERS and all(_apart_m(cloth, one, other) > APART_M for other in kept):
            kept.append(one)
    return tuple(kept[1:])


def _apart_m(cloth: SearchedCloth, one: WearerCandidate, other: WearerCandidate) -> float:
    """How far [m] the skin under the cloth is from where ``other`` has the same skin."""
    thin = thin_body(one.body)
    skin, there = (posed_by(thin, each.parameters) for each in (one, other))
    under = KDTree(skin).query(one.reading.apply(cloth.points))[1]
    moved = one.reading.apply(there[under] @ other.reading.turn / other.reading.scale)
    return float(np.linalg.norm(moved - skin[under], axis=1).mean())


def the_wearer(mesh: GarmentMesh, body: BodyModel, told: ToldReading = NOTHING_TOLD) -> WearerCandidate:
    """The likeliest body; raises ``MeshError`` where none fits and says which part does not."""
    found = find_wearers(mesh, body, told)
    if not found or found[0].fault:
        used = mesh.vertices[np.unique(mesh.faces)]
        extent = " x ".join(f"{length:.4g}" for length in np.ptp(used, axis=0))
        cure = "Say which avatar it was modelled on (avatar), its unit (unit) and its up axis (up)."
        if told != NOTHING_TOLD:
            cure = "Leave out what was said of the file (unit, up, facing), or say which avatar it was modelled on."
        raise MeshError(
            "garment",
            expected="cloth that a human body fits in, in some unit and pose",
            got=f"an extent of {extent}; " + (found[0].fault if found else "no unit makes that a garment"),
            cure=cure,
        )
    return found[0]


def _without_pits(mesh: GarmentMesh, fields: Sequence[Field], guess: Guess) -> np.ndarray:
    """Which faces (F,) are of no pit by the bones of a ``guess``: fits would keep a neck out of a closed collar."""
    points = guess.reading.apply(mesh.vertices)
    return without_pits(points, mesh.faces, fields[guess.number].bones.joints - guess.move)


def _fitted(cloth: SearchedCloth, body: BodyModel, guesses: Sequence[Guess]) -> list[WearerCandidate]:
    """The best of the ``guesses``, fitted: one for each reading."""
    kept: list[Guess] = []
    for one in guesses:
        rivals = [other for other in kept if other.reading == one.reading]
        alike = [other for other in kept if other.reading.unit == one.reading.unit]
        fresh = one.number not in [other.number for other in rivals]
        if fresh and len(rivals) < 3 and (len(alike) < 2 or len(kept) < FINALISTS):
            kept.append(one)
    thin = thin_body(body)
    fields = known_fields(body)
    read = list(dict.fromkeys(one.reading for one in kept))
    contours = dict(zip(read, each(cloth.contours, read), strict=True))
    starts = [_Start.of(one, fields[one.number]) for one in kept]
    tops = {one.reading: one for one in reversed(starts)}
    starts += [_with_arms(cloth, thin, one) for one in tops.values()]
    first = _on(thin, each(lambda one: _fit(cloth, thin, contours[one.reading], one, FIRST_STEPS), starts))
    first.sort(key=lambda one: one.rank)
    likely: list[WearerCandidate] = []
    for one in first:
        rivals = [other for other in likely if other.reading == one.reading]
        if one.rank < CLEARLY + first[0].rank and len(rivals) < RIVALS and len(likely) < WINNERS:
            likely.append(one)
    chosen = _on(thin, each(lambda one: _refined(cloth, thin, contours[one.reading], one), likely))
    rest = [one for one in first if one not in likely]
    apart: list[WearerCandidate] = []
    for one in (*sorted(chosen, key=lambda one: one.among), *rest):
        if all(one.reading != other.reading or _apart_m(cloth, one, other) > APART_M for other in apart):
            alike = [other for other in chosen if other.reading == one.reading]
            as_good = [other for other in alike if other.among < one.among + AS_GOOD]
            slid = max([_apart_m(cloth, one, other) for other in as_good], default=0.0)
            apart.append(replace(one, body=body, slid_m=slid))
    return apart


def _on(body: BodyModel, found: Sequence[WearerCandidate]) -> list[WearerCandidate]:
    """``found`` on ``body`` itself, of which those from other processes have a copy."""
    return [replace(one, body=body) for one in found]


def _refined(cloth: SearchedCloth, body: BodyModel, contours: list[Contour], one: WearerCandidate) -> WearerCandidate:
    """``one`` after more steps, the last of them without ``contours``.

    The middle of a sleeve's or an armhole's rim is below the bone: that leads arms into sleeves, and no farther.
    """
    led = min(one, _fit(cloth, body, contours, one, LAST_STEPS), key=lambda fit: fit.energy)
    free = _fit(cloth, body, [], led, FREE_STEPS, 0.0 if led.origin == "floor" else LOCK)
    return free if free.energy < led.energy + WORSE else led


def _on_standard(cloth: SearchedCloth, body: BodyModel, readings: Sequence[Reading]) -> WearerCandidate | None:
    """The standard body in T-pose at the file's origin or on its floor, where cloth goes round it and not into it."""
    thin = thin_body(body)
    starts = [(reading, rise) for reading in readings for rise in (0.0, -body.floor_m())]

    def judged(start: tuple[Reading, float]) -> WearerCandidate:
        return judge(cloth, start[0], thin, start_parameters(body, 0.0, np.array([0.0, start[1], 0.0])), 0.0)

    found = []
    for (reading, rise), one in zip(starts, each(judged, starts), strict=True):
        limits = PLAIN_LIMITS if reading.unit == "m" and reading.up == "+y" and rise == 0.0 else LIMITS
        if (np.array([one.inside, one.open_share, one.energy]) < limits).all():
            found.append(one)
    best = min(found, key=lambda one: one.energy, default=None)
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


def _with_arms(cloth: SearchedCloth, body: BodyModel, one: _Start) -> _Start:
    """``one`` with arms as low as the cloth fits them best, and where straight ones do not lie in it, bent forward."""
    straight = [_armed(body, one, lift, 0.0) for lift in ARM_LIFTS_RAD]
    energy = each(lambda other: judge(cloth, other.reading, body, other.parameters, 0.0), straight)
    best = min(range(len(straight)), key=lambda number: energy[number].energy)
    if not energy[best].sleeved or energy[best].energy < BENT_ENERGY:
        return straight[best]
    bent = [_armed(body, one, lift, bend) for lift in BENT_LIFTS_RAD for bend in BENDS_RAD]
    lower = each(lambda other: judge(cloth, other.reading, body, other.parameters, 0.0).energy, bent)
    return [straight[best], *bent][int(np.argmin([energy[best].energy, *lower]))]


def _armed(body: BodyModel, one: _Start, lift_rad: float, bend_rad: float) -> _Start:
    """``one`` with arms ``lift_rad`` below the horizontal and elbows bent by ``bend_rad``, forward and then inward."""
    parameters = one.parameters.copy()
    arms = slice(body.shape_count, -3)
    parameters[arms] = start_parameters(body, lift_rad, np.zeros(3))[arms]
    for side, sign in (("left", -1.0), ("right", 1.0)):
        for joint, share in (("shoulder", BENT_INWARD), ("elbow", 1.0)):
            number = FREE_JOINTS.index(JOINT_NAMES.index(f"{side}_{joint}"))
            parameters[body.shape_count + 3 * number + 1] = share * sign * bend_rad
    return one._replace(parameters=parameters, odd_arms=ODD_ARMS)


def _fit(
    cloth: SearchedCloth,
    body: BodyModel,
    contours: list[Contour],
    one: _Start | WearerCandidate,
    steps: int,
    lock: float = 0.0,
) -> WearerCandidate:
    """The body fitted to a reading from where ``one`` is, and how well the garment lies on it."""
    reading, start, origin = one.reading, one.parameters, one.origin
    points, normals = reading.apply(cloth.points), cloth.normals @ reading.turn.T
    skin = posed_by(body, start)
    near = KDTree(skin).query(points)[1]
    # By pieces: a wall of a sleeve that lies in the arm, or beyond it, shall come back.
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
    return judge(cloth, reading, body, parameters, one.odd_arms)


def _held(cloth: SearchedCloth, one: WearerCandidate) -> float:
    """Near 1 where cloth holds its body in its place: the same body higher or lower fits clearly worse."""
    thin, rises = thin_body(one.body), []
    for rise in (-HELD_M, 0.0, HELD_M):
        parameters = one.parameters + np.concatenate([np.zeros(len(one.parameters) - 2), [rise, 0.0]])
        rises.append(judge(cloth, one.reading, thin, parameters, one.odd_arms).energy)
    held = (min(rises[0], rises[2]) - rises[1]) / HELD + (HELD_ORIGIN if one.origin else 0.3)
    return float(np.clip(held, 0.3, 1.0) * np.clip(1.0 - one.slid_m / SLID_M, 0.3, 1.0))


def _sureness(one: WearerCandidate, found: Sequence[WearerCandidate]) -> float:
    """Near 1 where every other reading fits clearly worse and the cloth lies near the skin."""
    rival = min((other.rank for other in found if other.reading != one.reading), default=np.inf)
    return float(np.clip((rival - one.rank) / RIVAL, 0.05, 1.0) * np.clip(1.2 - one.energy, 0.1, 1.0))
