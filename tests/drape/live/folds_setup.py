"""A sleeve on an arm, small enough for the reference: cloth, the body's skin samples, and frames of both in motion."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from drape.cloth.energies import ClothMesh
from drape.cloth.rest_state import RestState, modelled
from drape.contact.samples import Samples, sample_table
from drape.live.fold_constants import WornCloth
from drape.live.fold_step import Frame
from drape.live.skin_contact import nearest_at_rest, skin_graph
from tests.drape.cloth.cloth_shapes import tube
from tests.drape.kernels.solver_setup import MATERIALS

RADIUS_M, HEIGHT_M, EASE_M = 0.05, 0.12, 0.006
AWAY_M = 0.4  # of the wall at rest; in frames it is at the sleeve


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


def sleeve(material: str = "rib", *, creased: bool = True) -> tuple[np.ndarray, WornCloth]:
    """A tube with ease over the arm, its vertices [m] (V, 3), held at its upper rim; a hem is folded at rest."""
    rest, faces = tube(11, 6, radius_m=RADIUS_M + EASE_M, height_m=HEIGHT_M)
    state = modelled(rest, faces)
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
