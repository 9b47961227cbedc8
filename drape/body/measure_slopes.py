"""How measures change with the shape of a body: their derivatives by its coefficients, in closed form.

Vertices are linear in the shape. A girth is the perimeter of a hull whose corners lie on edges: a corner moves with the
ends of its edge, and along the edge with the level of the section. Where the hull takes another corner the perimeter
has no kink, and where the section takes another edge a small one.
"""

from __future__ import annotations

import numpy as np

from drape.body.measures import DENSITY_KG_M3, SLEEVES, Measures, landmarks, section_tape
from drape.body.model import BodyModel
from drape.geometry import meshes


def measure_slopes(body: BodyModel, betas: np.ndarray) -> np.ndarray:
    """Returns the derivatives (8, S) of the ``Measures`` of ``body``, in their order, by its shape coefficients at the
    shape ``betas`` (S,): [m] and, of the weight, [kg] per standard deviation."""
    place, vertices, moved = landmarks(body), body.rest_vertices(betas), body.shapedirs
    # Levels are linear in vertices.
    by_level = np.array([place.levels(moved[..., k]) for k in range(body.shape_count)]).T
    girths = zip(place.levels(vertices), by_level, strict=True)
    chest, waist, hip = (_girth_slopes(vertices, moved, place.trunk, y, by) for y, by in girths)
    crown, soles = moved[vertices[:, 1].argmax(), 1], moved[vertices[:, 1].argmin(), 1]
    joints = body.rest_joints(betas)[SLEEVES], body.joint_shapedirs[SLEEVES]  # (2 arms, 3 joints, ...)
    slopes = {
        "height_m": crown - soles,
        "chest_m": chest,
        "waist_m": waist,
        "hip_m": hip,
        "inseam_m": moved[place.crotch, 1] - soles,
        "sleeve_m": _way_slopes(*(np.diff(of, axis=1) for of in joints)).sum(axis=1).mean(axis=0),
        "shoulder_m": _way_slopes(*(np.subtract(*of[place.shoulders]) for of in (vertices, moved))),
        "weight_kg": DENSITY_KG_M3 * _volume_slopes(vertices, body.faces, moved),
    }
    return np.array([slopes[name] for name in Measures._fields])


def _girth_slopes(
    vertices: np.ndarray, moved: np.ndarray, edges: np.ndarray, y: float, by_level: np.ndarray
) -> np.ndarray:
    """Derivatives (S,) of ``section_girth`` where vertices (V, 3) move by ``moved`` (V, 3, S), the level by
    ``by_level`` (S,)."""
    tape = section_tape(vertices, edges, y)
    corner = tape.hull.vertices  # Corners come in turn, around the hull.
    share, (first, second) = tape.share[corner, None], tape.edge[corner].T
    edge, move, turn = vertices[second] - vertices[first], moved[first], moved[second] - moved[first]
    along = (by_level - move[:, 1] - share * turn[:, 1]) / edge[:, 1:2]
    by_corner = (move + share[..., None] * turn + along[:, None] * edge[..., None])[:, [0, 2]]
    place = tape.hull.points[corner]
    return _way_slopes(*(np.roll(of, -1, axis=0) - of for of in (place, by_corner))).sum(axis=0)


def _way_slopes(way: np.ndarray, by_way: np.ndarray) -> np.ndarray:
    """Derivatives (..., S) of the lengths of ``way`` (..., C) that changes by ``by_way`` (..., C, S)."""
    return np.einsum("...c,...cs->...s", way / np.linalg.norm(way, axis=-1, keepdims=True), by_way)


def _volume_slopes(vertices: np.ndarray, faces: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Derivatives (S,) of the volume in the closed surface ``faces`` (F, 3): a face sweeps its area times its way."""
    swept, corners = np.repeat(meshes.area_vectors(vertices, faces) / 3.0, 3, axis=0), faces.reshape(-1)
    area = np.stack([np.bincount(corners, swept[:, axis], minlength=len(vertices)) for axis in range(3)], axis=1)
    return np.tensordot(area, moved, axes=2)
