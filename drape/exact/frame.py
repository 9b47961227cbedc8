"""One frame of a clip as physics itself: cloth at rest over a posed body, which nowhere passes through itself.

A clip's first frame starts from a drape of its pose. Where that passes through itself, the cloth is led there from the
T-pose and drawn to it as far as it can come. Every later frame starts from the one before it, moved as the drapes move
from frame to frame (``drape.exact.path``): cloth has many places of rest, and frames that each find their own one
flicker. Then it goes down until the force left is at most ``TOLERANCE`` of the weight (``drape.exact.apart``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.arrays import check_finite
from drape.body.model import BodyModel
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.cloth.material import Material
from drape.cloth.waistband import STIFFNESS_N_M2, Waistband, waistband
from drape.errors import MeshError
from drape.exact import apart, newton
from drape.exact.linear import Charts
from drape.exact.newton import TOLERANCE, Band, Cloth
from drape.exact.path import Body, draw_to, follow, lead
from drape.exact.settling import State
from drape.garment.cache import Garment
from drape.geometry.rotations import rotvec_to_matrix
from drape.geometry.triangle_pairs import crossing_pairs

STEPS = 400  # the most steps of Newton's method


@dataclass(frozen=True, eq=False)
class ExactCloth:
    """A garment of V vertices on a body of one shape: the constants of all frames of its clips.

    ``faces`` (F, 3) are its triangles, ``contact`` the body's skin, ``waist`` the waistband, None if shoulders hold the
    garment. ``rest`` [m] (V, 3) is a drape of the T-pose. All places count from the root joint.
    """

    cloth: Cloth
    faces: np.ndarray
    body: Body
    contact: BodyContact
    waist: Waistband | None
    rest: np.ndarray

    @classmethod
    def of(cls, garment: Garment, fabric: Fabric, model: BodyModel, betas: np.ndarray, rest: np.ndarray) -> ExactCloth:
        """Returns the constants of ``garment``, made of ``fabric``, on ``model`` in the shape ``betas`` (S,).

        ``rest`` [m] (V, 3) is a drape of the T-pose, relative to the root joint; the garment's own rest pose takes its
        place if fewer triangles cross there. Raises ``MeshError`` where triangles cross in both.
        """
        faces, own = garment.fine_faces.astype(np.int64), garment.vertices.astype(np.float64)
        mesh, material = ClothMesh.of(garment.rest_state(), faces, len(own)), Material.of(fabric)
        rests = (np.ascontiguousarray(rest, np.float64), own - model.rest_joints(betas)[0])
        counts = [len(crossing_pairs(each, faces)) for each in rests]
        if min(counts) > 0:
            raise MeshError(
                f"garment {garment.name}",
                expected="cloth that does not pass through itself in the T-pose",
                got=f"{min(counts)} pairs of triangles that cross",
                cure="Mend the garment, or drape it with tier accurate.",
            )
        return cls(
            Cloth.of(mesh, material, Charts(garment.chart_patch, garment.chart_weight)),
            faces,
            Body(model, betas),
            BodyContact(model.faces, model.vertex_count),
            waistband(own, faces, model),
            rests[int(np.argmin(counts))],
        )

    def band(self, start: np.ndarray) -> Band | None:
        """Returns the springs of the waistband, which hold it where it is in ``start`` [m] (V, 3); None without a
        waistband."""
        if self.waist is None:
            return None
        n_per_m = np.zeros(len(start))
        n_per_m[self.waist.vertex] = STIFFNESS_N_M2 * self.waist.length_m
        return Band(start, n_per_m)


@dataclass(frozen=True, eq=False)
class FrameFigures:
    """The figures of a computed frame.

    ``force_share``: the norm of the forces left at all vertices over the weight of the cloth, forces of contact with
    itself included. ``depth_m`` [m]: the largest depth of the cloth in the skin, 0 if it is nowhere in it. ``energy_j``
    [J] of cloth and body, heights counting from the root, and ``start_j`` that of the drape it started from.
    ``crossings``: how many pairs of triangles cross, and ``start_crossings`` in the start. ``steps`` of Newton's
    method.
    """

    force_share: float
    depth_m: float
    energy_j: float
    start_j: float
    crossings: int
    start_crossings: int
    steps: int


@dataclass(frozen=True, eq=False)
class RestingFrame:
    """A computed frame: its ``pose`` (24, 3) [rad], its cloth ``x`` [m] (V, 3), and the drape ``start`` [m] (V, 3) that
    it was computed from. Cloth and start are relative to the root joint."""

    pose: np.ndarray
    x: np.ndarray
    start: np.ndarray


def exact(
    sheet: ExactCloth, pose: np.ndarray, start: np.ndarray, before: RestingFrame | None = None
) -> tuple[RestingFrame, FrameFigures]:
    """Returns the drape of a ``pose`` (24, 3) [rad] and its figures.

    ``start`` [m] (V, 3), relative to the root joint, is the pose's drape of tier accurate. The descent begins at the
    cloth of the frame ``before`` if there is one, unless that crosses itself and ``start`` does not. Otherwise it
    begins at ``start``, or at the T-pose if ``start`` crosses itself. If it ends with more energy than ``start`` has,
    the descent is repeated from ``start``, and the cloth may still cross. Raises ``MeshError`` where ``start`` is not
    finite.
    """
    start = np.ascontiguousarray(start, np.float64)
    check_finite("start of a frame", start, error=MeshError)
    posed, band = sheet.body.posed(pose), sheet.band(start)
    crossed = len(crossing_pairs(start, sheet.faces))
    usable = crossed > 0 or _apart(sheet, before)
    x = _arrived(sheet, pose, start, before if usable else None, crossed > 0)
    start_j = _over(sheet, posed, start, band).now.energy
    end = _down(sheet, posed, x, band)
    if x is not start and _over(sheet, posed, end.x, band).now.energy > start_j:
        # The energy must not rise, though what crosses in the start then crosses in the end.
        end = _down(sheet, posed, start, band)
    x = end.x.astype(np.float32).astype(np.float64)  # float32 is what is stored, and the next frame begins there
    over = _over(sheet, posed, x, band)
    report = FrameFigures(
        force_share=float(np.linalg.norm(end.gradient)) / sheet.cloth.weight_n,
        depth_m=max(over.deepest_m(), 0.0),
        energy_j=over.now.energy,
        start_j=start_j,
        crossings=len(crossing_pairs(x, sheet.faces)),
        start_crossings=crossed,
        steps=end.steps,
    )
    return RestingFrame(pose, x, start), report


def _apart(sheet: ExactCloth, before: RestingFrame | None) -> bool:
    """Whether there is a frame ``before``, and nothing crosses there."""
    return before is not None and not len(crossing_pairs(before.x, sheet.faces))


def _arrived(
    sheet: ExactCloth, pose: np.ndarray, start: np.ndarray, before: RestingFrame | None, crossed: bool
) -> np.ndarray:
    """The cloth [m] (V, 3) over the ``pose`` (24, 3) that goes down from there."""
    cloth, contact, body = sheet.cloth, sheet.contact, sheet.body
    if before is not None:
        return follow(cloth, contact, body, before.x, start - before.start, (before.pose, pose))
    if not crossed:
        return start
    t_pose = np.zeros_like(pose)
    t_pose[0] = pose[0]  # the root is turned as in the pose
    rest = np.ascontiguousarray(sheet.rest @ np.asarray(rotvec_to_matrix(pose[0])).T)
    x = lead(cloth, contact, body, rest, (t_pose, pose))
    return draw_to(cloth, contact, body.posed(pose), x, start, sheet.band(start))


def _down(sheet: ExactCloth, posed: np.ndarray, x: np.ndarray, band: Band | None) -> State:
    """Where the cloth comes down to from ``x`` [m] (V, 3) over the ``posed`` body."""
    descent = apart.ApartDescent(sheet.cloth, sheet.contact, posed, x, band=band)
    return descent.run(STEPS, TOLERANCE * sheet.cloth.weight_n)


def _over(sheet: ExactCloth, posed: np.ndarray, x: np.ndarray, band: Band | None) -> newton.Descent:
    """The cloth ``x`` [m] (V, 3) over the ``posed`` body, whose energy is without the barrier's."""
    return newton.Descent(sheet.cloth, sheet.contact, posed, x, band=band)
