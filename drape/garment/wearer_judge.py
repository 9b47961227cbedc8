"""How well a garment lies on a body that may have worn it: an energy, and in words what does not fit."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.garment.registration import posed_by, posed_normals, unpack_parameters
from drape.garment.searched_cloth import SearchedCloth
from drape.garment.wearer_fields import SHAPES, Bones, bones_of, enclosed, joints_of, point_cost
from drape.garment.wearer_reading import Reading, WearerCandidate

BAND_M, BAND_WEIGHT = 0.15, 2.0  # a garment hangs on its body in this band at its top
# Shares taken off the cost of upright cloth below that band, away from the skin: of skirts, and of capes over arms.
HANGING, HANGING_OVER_ARMS = 0.3, 0.9
SHAPE_COST = 0.01  # cost of a squared beta, counted from the nearest known shape
UPRIGHT = [JOINT_NAMES.index(name) for name in ("pelvis", "spine1", "spine2", "spine3", "neck", "head")]
TURNED_COST = 0.3  # cost of the squared turn [rad] of these joints together: wearers stand straight
HEIGHT_M, HEIGHT_SPREAD_M, HEIGHT_COST = 1.73, 0.13, 0.01  # heights of people; cost of one spread
# Costs of a body whose root and soles are away from the origin, of a bone through the cloth, of cloth on one side
# alone, of an opening without a bone, and of cloth where none is worn (``misplaced``).
ODD_ORIGIN, ODD_PIERCED, ODD_SIDE, ODD_EMPTY, ODD_PLACE = 0.03, 0.1, 0.3, 0.05, 0.3
EMPTY_MOST = 1  # long openings without a bone that a garment has: a vent, a pocket, a hood's
# Shares: of all points, those on a piece that counts; of its points, those off the trunk, or above the crown.
PIECE_SHARE, OFF_TRUNK, ABOVE = 0.2, 0.995, 0.75
WRONG_MOST = 0.5  # share of the cloth that may be misplaced
ORIGIN_M = 0.05  # a body whose root or soles are this near to the file's origin stands where bodies do
INSIDE_LIMIT, OPEN_LIMIT, BAND_LIMIT_M = 0.12, 0.35, 0.08
DEEP_M, INSIDE_COST = 0.01, 0.5  # cost of the share of cloth that is deeper in the skin
UNEVEN, UNEVEN_MOST_M = 10.0, 0.03  # cost of a metre off the median distance at the top, or in the skin; most of it
SLEEVE_SHARE = 0.04  # share of the cloth that must lie on the arms to show their pose
UNIT_INSIDE = 0.06  # share of cloth in the skin up to which a unit is accepted
# A body of more energy has not worn the cloth; in a reading odder than RARE the limit is RARE_LIMIT.
ENERGY_LIMIT, RARE_LIMIT, RARE = 0.7, 0.42, 0.03
HELD_LIMIT = 0.25  # energy without what hangs away from the skin, up to which a train may be of any length


def judge(
    cloth: SearchedCloth, reading: Reading, body: BodyModel, parameters: np.ndarray, odd_arms: float
) -> WearerCandidate:
    """Returns ``body`` with ``parameters`` (``unpack_parameters``) as a candidate, with the energy and the faults of
    the cloth on it. Body and cloth lie in the frame that ``reading`` gives. ``odd_arms`` is added to the energy: the
    cost of the arms in ``KNOWN`` from which the body was fitted."""
    points, skin = reading.apply(cloth.points), posed_by(body, parameters)
    distance = _distance(points, skin, body)
    band = points[:, 1] > points[:, 1].max() - BAND_M
    weight = np.where(band, BAND_WEIGHT, 1.0)
    bones = bones_of(joints_of(body, parameters), skin)
    share, nearest = enclosed(points, bones)
    parts = np.array(bones.part)[nearest]
    sleeved = float(np.isin(parts, ("left arm", "right arm")).mean()) > SLEEVE_SHARE
    pierced = cloth.pierced(reading, bones.joints)
    odd, origin = _oddness(body, parameters, skin)
    odd += reading.oddness + cloth.oddness(reading) + odd_arms + ODD_PIERCED * len(pierced)
    empty, wrong = cloth.empty(reading, bones.joints), misplaced(points, bones, nearest, cloth.piece)
    odd += ODD_SIDE * one_sided(bones, nearest) + ODD_EMPTY * empty + ODD_PLACE * wrong
    lying = distance[band]
    uneven = UNEVEN * float(np.minimum(np.abs(lying - np.median(lying)), UNEVEN_MOST_M).mean())
    uneven += UNEVEN * float(np.clip(-distance, 0.0, DEEP_M).mean())
    inside, open_share = distance < -DEEP_M, 1.0 - float(share.mean())
    cost = point_cost(distance) * weight / weight.sum()
    wall = 1.0 - np.abs(cloth.normals @ reading.turn[1])
    hanging = ~band & (distance > 0.0)
    top = float(np.median(np.abs(lying)))
    over_arms = top < BAND_LIMIT_M and cloth.covers(reading, bones)
    cost *= 1.0 - (HANGING_OVER_ARMS if over_arms else HANGING) * wall * hanging
    among = float(cost[~hanging].sum()) + open_share + odd + uneven
    among += ODD_ORIGIN if over_arms and not origin else 0.0  # such cloth shows little else of who wears it
    energy = float(cost.sum()) + open_share + odd + INSIDE_COST * float(inside.mean())
    far = energy > RARE_LIMIT if reading.oddness > RARE else energy > ENERGY_LIMIT and among > HELD_LIMIT
    fault = _place_fault(empty, wrong) or _inside_fault(inside, parts)
    fault = fault or _other_fault(far, distance, inside, pierced, open_share, top)
    return WearerCandidate(
        reading, body, parameters, energy, float(inside.mean()), open_share, top, sleeved, fault, odd_arms, origin,
        among=among,
    )  # fmt: skip


def _distance(points: np.ndarray, skin: np.ndarray, body: BodyModel) -> np.ndarray:
    """How far [m] (N,) ``points`` are outside the ``skin``, along its normals where they are near."""
    far, near = KDTree(skin).query(points)
    along = np.einsum("nc,nc->n", posed_normals(body, skin)[near], points - skin[near])
    return np.where(far > 2.0 * BAND_LIMIT_M, np.copysign(far, along), along)


def _oddness(body: BodyModel, parameters: np.ndarray, skin: np.ndarray) -> tuple[float, str]:
    """The cost of a body that few are, and where in it the file's origin is."""
    betas, pose, trans = unpack_parameters(body, parameters)
    odd = SHAPE_COST * min(float(((betas[:10] - shape) ** 2).sum()) for shape in map(np.array, SHAPES.values()))
    odd += TURNED_COST * float((pose[UPRIGHT].sum(axis=0) ** 2).sum())
    odd += HEIGHT_COST * ((np.ptp(body.rest_vertices(betas)[:, 1]) - HEIGHT_M) / HEIGHT_SPREAD_M) ** 2
    heights = {"root": abs(trans[1]), "floor": abs(skin[:, 1].min()), "": ORIGIN_M}
    origin = min(heights, key=lambda name: heights[name]) if np.abs(trans[[0, 2]]).max() < ORIGIN_M else ""
    return odd if origin else odd + ODD_ORIGIN, origin


def _inside_fault(inside: np.ndarray, parts: np.ndarray) -> str:
    if inside.mean() <= INSIDE_LIMIT:
        return ""
    names, counts = np.unique(parts[inside], return_counts=True)
    return f"at best the {names[counts.argmax()]} cuts through it ({100.0 * inside.mean():.0f} % lies inside)"


def _other_fault(
    far: bool, distance: np.ndarray, inside: np.ndarray, pierced: tuple[str, ...], open_share: float, top_m: float
) -> str:
    if far:
        return f"at best it lies {1e3 * np.abs(distance).mean():.0f} mm from the skin on average"
    if pierced and inside.mean() > UNIT_INSIDE:
        return f"at best the {pierced[0].replace('_', ' ')} goes through the cloth"
    if open_share > OPEN_LIMIT:
        return f"at best {100.0 * open_share:.0f} % of the way round the body is open"
    return f"at best its top hangs {1e3 * top_m:.0f} mm from the skin" if top_m > BAND_LIMIT_M else ""


def _place_fault(empty: int, wrong: float) -> str:
    if empty > EMPTY_MOST:
        return f"at best {empty} of its long openings, as of sleeves and legs, have no limb in them"
    return "at best it lies on the crown, or goes round both legs or arms as one" if wrong > WRONG_MOST else ""


def one_sided(bones: Bones, nearest: np.ndarray) -> float:
    """Returns the share in [0, 1] of the points on cloth that lie on limbs of one side and have no counterpart on the
    other. ``nearest`` (N,) is the row in ``bones`` nearest to each point."""
    side = np.array([part.startswith("left") - 1.0 * part.startswith("right") for part in bones.part])
    return abs(float(side[nearest].mean()))


def misplaced(points: np.ndarray, bones: Bones, nearest: np.ndarray, piece: np.ndarray) -> float:
    """Returns the share in [0, 1] of the cloth at ``points`` [m] (N, 3) that lies where no garment is worn. That is a
    piece around limbs of both sides with hardly any cloth on the trunk, a piece that lies on top of the crown, and
    pieces on the head where there are several. ``nearest`` (N,) is the row in ``bones`` nearest to each point, and
    ``piece`` (N,) the number of its piece."""
    parts = np.array(bones.part)
    side = np.array([part.startswith("left") - 1 * part.startswith("right") for part in parts])[nearest]
    head, crown = parts[nearest] == "head", np.flatnonzero(parts == "head")[-1]
    above = (points - bones.at[crown]) @ bones.frames[crown, 2] > 0.0
    limbs, hats, lying = 0.0, [], 0.0
    for number in np.flatnonzero(np.bincount(piece) > PIECE_SHARE * len(piece)):
        own = piece == number
        left, right = (side[own] > 0).mean(), (side[own] < 0).mean()
        if left + right > OFF_TRUNK and min(left, right) > PIECE_SHARE:
            limbs += own.mean()
        elif head[own].mean() > OFF_TRUNK:
            hats.append(own.mean())
            lying += own.mean() * (above[own].mean() > ABOVE)
    return float(limbs + (sum(hats) if len(hats) > 1 else lying))
