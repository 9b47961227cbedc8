"""A sleeve on an arm, small enough for the reference: cloth, the body's skin samples, and frames of both in motion."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np
import scipy.sparse

from drape.cloth.energies import ClothMesh
from drape.cloth.rest_state import RestState, modelled_rest
from drape.contact.samples import Samples, sample_table
from drape.engine.library import LANES, empty_points
from drape.live.clock import Frame
from drape.live.fold_constants import FoldConstants, WornCloth
from drape.live.fold_step import FoldEffort, FoldMemory, FoldReport, fold
from drape.live.skin_walks import nearest_at_rest, skin_graph
from tests.drape.cloth.cloth_shapes import tube
from tests.drape.cloth.solver_setup import MATERIALS

RADIUS_M, HEIGHT_M, EASE_M = 0.05, 0.12, 0.006
PLANE_ROWS = 19  # of a block of places: a point and a normal of the own part, then those of another one
FAR_M = 0.25  # a vertex farther from the network's drape is no fold
CUT_M = 0.30  # a frame in which the network moved a vertex farther has no past
AWAY_M = 0.4  # of the wall at rest; in frames it is at the sleeve
EFFORT = FoldEffort(steps=2, settle=2)
HELD = EFFORT._replace(cloth_contact=True)
Folded = tuple[np.ndarray, FoldMemory, FoldReport]


@cache
def arm(around: int = 14, along: int = 9) -> Samples:
    """Samples on a cylinder about the y axis, longer than the sleeve, and on a wall that is far away at rest."""
    angle, height = np.meshgrid(
        2.0 * np.pi * np.arange(around) / around, np.linspace(-0.02, HEIGHT_M + 0.02, along), indexing="ij"
    )
    normal = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1).reshape(-1, 3)
    point = RADIUS_M * normal + height.reshape(-1, 1) * np.array([0.0, 1.0, 0.0])
    wall = np.stack(np.meshgrid([AWAY_M], 0.02 * np.arange(7), 0.02 * np.arange(-3, 4)), axis=-1).reshape(-1, 3)
    point, normal = np.vstack([point, wall]), np.vstack([normal, np.tile([-1.0, 0.0, 0.0], (len(wall), 1))])
    none = scipy.sparse.csr_matrix((3 * len(point), 1))
    return Samples(none, point, normal, np.full(len(point), 2.0 * np.pi * RADIUS_M / around))


@cache
def sleeve(material: str = "rib", *, creased: bool = True) -> tuple[np.ndarray, WornCloth]:
    """A tube with ease over the arm, its vertices [m] (V, 3), held at its upper rim; a hem is folded at rest."""
    rest, faces = tube(11, 6, radius_m=RADIUS_M + EASE_M, height_m=HEIGHT_M)
    state = modelled_rest(rest, faces)
    kept = np.arange(len(state.hinge_angle)) % 5 == 0 if creased else np.zeros(len(state.hinge_angle), bool)
    state = RestState(state.edges, np.where(kept, 0.5, 0.0), state.stiffening)
    dressed = WornCloth(
        cloth=ClothMesh.of(state, faces, len(rest)),
        material=MATERIALS[material],
        band_n_per_m=np.where(rest[:, 1] > HEIGHT_M - 1e-6, 10.0, 0.0),
        graph=skin_graph(arm()),
        index=nearest_at_rest(rest, arm()),
        friction=0.4,
    )
    return rest, dressed


@cache
def constants(material: str = "rib", *, creased: bool = True, dtype: type[np.floating] = np.float32) -> FoldConstants:
    """Those of ``sleeve``."""
    return FoldConstants.of(sleeve(material, creased=creased)[1], dtype=dtype)


def folded(
    made: FoldConstants, frames: Iterable[Frame], effort: FoldEffort = EFFORT, memory: FoldMemory | None = None
) -> list[Folded]:
    """What ``fold`` gives of ``frames``, one after the other."""
    found = []
    for one in frames:
        found.append(fold(made, memory, one, effort))
        memory = found[-1][1]
    return found


def held_for(one: Frame, count: int, *, start: int = 0) -> list[Frame]:
    """``count`` frames at 30 a second in which nothing moves."""
    return [replace(one, time_s=number / 30.0) for number in range(start, start + count)]


def shifted(one: Frame, shift: np.ndarray, *, cloth: bool = True) -> Frame:
    """``one`` with the body ``shift`` [m] (3,) away, and with the cloth if it goes along."""
    skin = sample_table(one.skin[:, :3] + shift, one.skin[:, 4:7])
    return Frame(one.vertices + shift if cloth else one.vertices, np.asarray(skin), one.time_s)


def without_body(one: Frame) -> Frame:
    """``one`` with the body far away."""
    return shifted(one, np.array([5.0, 5.0, 5.0]), cloth=False)


def planes_of(point: np.ndarray, normal: np.ndarray, other: object = 0.0, across: object = 0.0) -> np.ndarray:
    """Planes as the engine has them, for places (P, 3): points [m] and normals of the own part, and of another one.

    Nothing holds the places or rubs.
    """
    rows = np.zeros((len(point), PLANE_ROWS), point.dtype)
    for i, part in enumerate((point, normal, other, across)):
        rows[:, 3 * i : 3 * i + 3] = part
    return np.ascontiguousarray(rows.reshape(-1, LANES, rows.shape[1]).transpose(0, 2, 1)).reshape(-1)


def rows_of(planes: np.ndarray) -> np.ndarray:
    """The rows (P, ``PLANE_ROWS``) of ``planes`` for each place."""
    return planes.reshape(-1, PLANE_ROWS, LANES).transpose(0, 2, 1).reshape(-1, PLANE_ROWS)


def spared(points: np.ndarray) -> np.ndarray:
    """``points`` (P, 3) once more, with the room behind them that the engine needs."""
    found = empty_points(len(points), points.dtype)
    found[:] = points
    return found


def turn_about_y(angle_rad: float) -> np.ndarray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def frame(rest: np.ndarray, number: int, *, rotation: np.ndarray | None = None, noise_m: float = 0.002) -> Frame:
    """Frame ``number`` at 30 a second: arm and sleeve swing and twist, the drape of the network is a little rough."""
    skin = arm()
    near = skin.point - np.where(skin.point[:, :1] == AWAY_M, [AWAY_M - RADIUS_M - 0.008, 0.0, 0.0], 0.0)
    bend = 0.3 * np.sin(0.5 * number)

    def moved(points: np.ndarray) -> np.ndarray:
        swung = points + np.outer(points[:, 1] ** 2, [bend / HEIGHT_M, 0.0, 0.0])
        return swung @ turn_about_y(0.1 * number).T @ (np.eye(3) if rotation is None else rotation).T

    ahead = 1e-6
    normal = (moved(near + ahead * skin.normal) - moved(near)) / ahead
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rough = rest + noise_m * np.random.default_rng(number).normal(size=rest.shape)
    return Frame(moved(rough), np.asarray(sample_table(moved(near), normal)), number / 30.0)
