"""Does it fit? Where a draped garment is tight or loose, in numbers by regions of the body and in plain words.

Regions are named by the joint whose bone leads the cloth. What is read is the smooth drape of the network, without
folds (``drape.cloth.tension``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from drape.body.measures import landmarks
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric as fabric_of
from drape.cloth.material import Material
from drape.cloth.tension import Tension, cloth_tension
from drape.garment.cache import Garment
from drape.garment.ease import Ease, eases
from drape.geometry.closest import signed_distance

TOUCH_M = 0.008  # cloth this near lies on the skin: it is kept 4 mm off, and the network errs by as much
REGIONS: dict[str, tuple[str, ...]] = {
    "neck": ("neck", "head"),
    "shoulders": ("left_collar", "right_collar"),
    "chest": ("spine3",),
    "waist": ("spine1", "spine2"),
    "hips": ("pelvis",),  # and what hangs on the hip joints above the crotch
    "thighs": ("left_hip", "right_hip"),
    "lower legs": ("left_knee", "right_knee", "left_ankle", "right_ankle", "left_foot", "right_foot"),
    "upper arms": ("left_shoulder", "right_shoulder"),
    "forearms": ("left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand"),
}
LEAST_AREA_M2 = 0.005  # a region with less cloth is a strip of its neighbour's
HIGH_SHARE = 0.95

TIGHT, VERY_TIGHT = 0.03, 0.1  # mean strain of a region
HELD_SHARE = 0.2  # a tight region lies on the skin with this share: cloth that hangs is stretched by its weight
SMALL_M = 0.005  # a garment is too small if it is smaller than the body by more
LOOSE_SHARE = 0.12  # ease above this share of the body's girth is loose
LOOSE_GAP_M = 0.03  # mean distance from the skin above which limbs, whose girth is not measured, are loose
_LIMBS = ("thighs", "lower legs", "upper arms", "forearms")
_ROUND = {"chest_m": "chest", "waist_m": "waist", "hip_m": "hips"}


class Region(NamedTuple):
    """The figures of one region's cloth: ``area_m2``, its area at rest; ``warp`` and ``weft``, mean strains along them;
    ``high``, the strain along either that a twentieth of the cloth exceeds; ``touching``, the share in [0, 1] that lies
    on the skin; ``pressure_n_per_m2``, the mean pressure there; ``gap_m``, the mean distance from the skin. Means are
    by area, strains relative to the length at rest."""

    area_m2: float
    warp: float
    weft: float
    high: float
    touching: float
    pressure_n_per_m2: float
    gap_m: float


class FitReport(NamedTuple):
    """How a garment fits a body: sentences in ``words``; ``ease`` by level of the body; ``regions``, by their names in
    ``REGIONS``; and ``tension`` at each vertex of the subdivided mesh."""

    words: list[str]
    ease: dict[str, Ease]
    regions: dict[str, Region]
    tension: Tension


class JudgedDrape(NamedTuple):
    """A drape whose fit is reported, on a body of the shape ``betas``: its vertices ``vertices`` [m] (N, 3) in the rest
    pose, and ``posed`` [m] (N, 3) in the pose ``pose`` (24, 3) [rad]. The vertices are all those of ``fine_faces``.
    ``pose`` and ``posed`` are None if the report is about the rest pose."""

    betas: np.ndarray
    vertices: np.ndarray
    pose: np.ndarray | None = None
    posed: np.ndarray | None = None


def fit_report(garment: Garment, body: BodyModel, worn: JudgedDrape, *, fabric: Fabric | None = None) -> FitReport:
    """Returns how ``garment``, draped as ``worn``, fits ``body``: ease in the rest pose; strain, pressure and distances
    in the pose of ``worn``. ``fabric`` is the garment's own by default."""
    faces, rest = garment.fine_faces.astype(np.int64), garment.rest_state()
    cloth = ClothMesh.of(rest, faces, len(garment.vertices))
    ease = eases(faces, rest, worn.vertices, body, worn.betas)
    cloth_at, skin = worn.vertices, body.rest_vertices(worn.betas)
    if worn.pose is not None and worn.posed is not None:
        cloth_at, skin = worn.posed, body.posed_vertices(worn.pose[None], None, worn.betas)[0]
    gap_m = signed_distance(cloth_at, skin, body.faces)
    touching = gap_m < TOUCH_M
    made_of = fabric_of(garment.fabric) if fabric is None else fabric
    tension = cloth_tension(cloth_at, cloth, Material.of(made_of).membrane, touching)
    named = regions_of(garment, body)
    regions = region_figures(named, cloth.vertex_area, tension, touching=touching, gap_m=gap_m)
    return FitReport(fit_words(regions, ease), ease, regions, tension)


def regions_of(garment: Garment, body: BodyModel) -> np.ndarray:
    """Returns for each vertex of ``garment`` the number (N,) int of its region in ``REGIONS``: the region of the bone
    with the largest weight, but "hips" for cloth of the thighs above the crotch."""
    of_joint = np.zeros(JOINT_COUNT, dtype=np.int64)
    names = list(REGIONS)
    for number, joints in enumerate(REGIONS.values()):
        of_joint[[JOINT_NAMES.index(joint) for joint in joints]] = number
    region = of_joint[garment.skin_weights(body).argmax(axis=1)]
    crotch_y = body.v_template[landmarks(body).crotch, 1]
    high = (region == names.index("thighs")) & (garment.vertices[:, 1] > crotch_y)
    return np.where(high, names.index("hips"), region)


def region_figures(
    named: np.ndarray, area: np.ndarray, tension: Tension, *, touching: np.ndarray, gap_m: np.ndarray
) -> dict[str, Region]:
    """Returns for each region with at least ``LEAST_AREA_M2`` of cloth its ``Region``, by its name in ``REGIONS``. Per
    vertex (N,): ``named``, the number of its region; ``area`` [m^2]; ``touching`` bool; ``gap_m``; and ``tension``."""
    regions = {}
    for number, name in enumerate(REGIONS):
        rows = named == number
        total = float(area[rows].sum())
        if total < LEAST_AREA_M2:
            continue
        share = area[rows] / total
        lies = float(touching[rows] @ share)
        stretched = np.maximum(tension.warp[rows], tension.weft[rows])
        regions[name] = Region(
            total,
            float(tension.warp[rows] @ share),
            float(tension.weft[rows] @ share),
            _quantile(stretched, share),
            lies,
            float(tension.pressure[rows] @ share) / lies if lies > 0.0 else 0.0,
            float(gap_m[rows] @ share),
        )
    return regions


def _quantile(values: np.ndarray, share: np.ndarray) -> float:
    """The value that ``HIGH_SHARE`` of the cloth does not exceed, ``share`` (n,) of which each value stands for."""
    order = np.argsort(values, kind="stable")
    reached = np.searchsorted(np.cumsum(share[order]), HIGH_SHARE)
    return float(values[order][min(int(reached), len(values) - 1)])


def fit_words(regions: Mapping[str, Region], ease: Mapping[str, Ease]) -> list[str]:
    """Returns sentences that say where a garment is tight, too small or loose; if it is so nowhere, one sentence that
    it fits."""
    sentences = [sentence for name, region in regions.items() for sentence in _tight(name, region)]
    for level, girths in ease.items():
        name, width_cm = _ROUND[level], 100.0 * girths.ease_m
        if girths.ease_m < -SMALL_M:
            sentences.append(f"too small at the {name}: {-width_cm:.0f} cm less than the body")
        elif girths.ease_m > LOOSE_SHARE * girths.body_m:
            sentences.append(f"loose at the {name}: {width_cm:.0f} cm of ease")
    sentences += [
        f"loose around the {name}: {100.0 * region.gap_m:.0f} cm off the skin"
        for name, region in regions.items()
        if name in _LIMBS and region.gap_m > LOOSE_GAP_M
    ]
    return sentences or ["fits: nothing pulls, and nothing stands far off"]


def _tight(name: str, region: Region) -> Sequence[str]:
    """The sentence about a region whose cloth is stretched, along the axis along which it is more; none otherwise."""
    strain, axis = max((region.weft, "weft"), (region.warp, "warp"))
    if strain < TIGHT or region.touching < HELD_SHARE:
        return ()
    much = "very tight" if strain >= VERY_TIGHT else "tight"
    return (f"{much} across the {name}: {100.0 * strain:.0f} % along the {axis}",)
