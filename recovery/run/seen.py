"""What a target shows of its cut: where its openings lie along the body, girths between them, the pieces of a texture.

Places are told along the bones and then counted on the body in its T-pose, where bases are drafted.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from drape.body.skeleton import JOINT_NAMES
from drape.garment.contours import TRUNK, Contour, bone_chains, open_contours, place_of
from drape.garment.files.mesh import GarmentMesh
from drape.geometry import mesh_graphs, meshes
from drape.geometry.sections import closed_rings, level_section

EVEN_STRETCH = 1.25  # of the middle one: within that most triangles of a panel laid out flat differ from each other
LAID_OUT = 0.9  # of the cloth that is so
LEAST_PIECE = 1e-3  # of all faces


@dataclass(frozen=True, eq=False)
class BodyOpening:
    """An opening's ``contour``, and where it lies on the wearer in the T-pose: ``points`` [m] (n, 3), their ``centre``.

    ``along_m`` counts along the bones of its part: from the shoulder or hip of a limb, from the pelvis of the trunk.
    """

    contour: Contour
    points: np.ndarray
    centre: np.ndarray
    along_m: float


class SeenGarment:
    """What is seen of a garment, ``vertices`` [m] (V, 3) and ``faces``, on a wearer whose ``joints`` [m] (24, 3) are
    known in its pose, and at ``rest`` in the T-pose.

    ``openings``: by part of the body, those of the trunk from above.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, rest: np.ndarray) -> None:
        self._vertices, self._faces = vertices, faces
        self._chains, self._rest = bone_chains(joints), bone_chains(rest)
        at = dict(zip(JOINT_NAMES, joints, strict=True))
        self.openings: dict[str, list[BodyOpening]] = {}
        for contour in open_contours(vertices, faces):
            place = place_of(contour, self._chains)
            if place.part is None:
                continue
            here, there = self._point(self._chains, place.part, place.along_m), self._at_rest(place.part, place.along_m)
            root = 0.0
            if place.part.endswith("arm"):
                side = place.part.split("_")[0]
                root = float(np.linalg.norm(at[f"{side}_shoulder"] - at[f"{side}_collar"]))
            centre = contour.centre - here + there
            found = BodyOpening(contour, contour.points - here + there, centre, place.along_m - root)
            self.openings.setdefault(place.part, []).append(found)
        self.openings.get(TRUNK, []).sort(key=lambda one: -one.along_m)

    def counts(self) -> dict[str, int]:
        """Returns how many openings each part of the body has."""
        return {part: len(found) for part, found in self.openings.items()}

    def girth(self, part: str, rest_axis: int, value_m: float) -> float | None:
        """Length [m] of the cloth round ``part`` where its bones, at rest, pass the plane x_axis = ``value_m``.

        It is measured across the bones. None where no cloth goes round them.
        """
        chain, below = self._rest[part]
        along = _where(chain, rest_axis, value_m)
        if along is None:
            return None
        point = self._point(self._chains, part, along - below)
        ahead = self._point(self._chains, part, along - below + 0.01)
        return girth_round(self._vertices, self._faces, point, ahead - point)

    def _at_rest(self, part: str, along_m: float) -> np.ndarray:
        return self._point(self._rest, part, along_m)

    def _point(self, chains: dict[str, tuple[np.ndarray, float]], part: str, along_m: float) -> np.ndarray:
        """The point (3,) of a part's bones ``along_m`` from its root."""
        chain, below = chains[part]
        lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(chain, axis=0), axis=1))])
        return np.array([np.interp(along_m + below, lengths, column) for column in chain.T])


def _where(chain: np.ndarray, axis: int, value: float) -> float | None:
    """How far along the line ``chain`` (n, 3) its coordinate first is ``value``."""
    run = 0.0
    for start, end in pairwise(chain):
        length, rise = float(np.linalg.norm(end - start)), float(end[axis] - start[axis])
        share = (value - float(start[axis])) / rise if rise else -1.0
        if 0.0 <= share <= 1.0:
            return run + share * length
        run += length
    return None


def girth_round(vertices: np.ndarray, faces: np.ndarray, point: np.ndarray, normal: np.ndarray) -> float | None:
    """Length [m] of the longest closed loop round ``point`` (3,) in which a plane across ``normal`` cuts the mesh.

    A loop goes round a point that its convex hull holds. None where no loop does.
    """
    right, ahead = np.linalg.svd(normal[None])[2][1:]
    level = (vertices - point) @ np.stack([right, normal / np.linalg.norm(normal), ahead]).T
    rings = closed_rings(level_section(faces, level, 0.0), level)
    return max((ring.length_m for ring in rings if (ring.hull.equations[:, -1] < 0.0).all()), default=None)


def pieces(mesh: GarmentMesh) -> int | None:
    """The number of panels that the texture of ``mesh`` shows; None where it is no layout of panels.

    It is one if it shows the cloth as it is cut: triangles have, but for one scale, the sizes that they have in space.
    """
    if not len(mesh.uv_faces):
        return None
    corner = mesh.uv[mesh.uv_faces]
    ways = corner[:, 1:] - corner[:, :1]
    flat = 0.5 * np.abs(ways[:, 0, 0] * ways[:, 1, 1] - ways[:, 0, 1] * ways[:, 1, 0])
    area = meshes.face_areas(mesh.vertices, mesh.faces)
    if not (flat > 0.0).all():
        return None
    ratio = np.sqrt(area / flat)
    ratio /= np.median(ratio)
    if float(area[(ratio < EVEN_STRETCH) & (ratio > 1.0 / EVEN_STRETCH)].sum() / area.sum()) < LAID_OUT:
        return None
    piece = mesh_graphs.connected_components(mesh.uv_faces, len(mesh.uv))[mesh.uv_faces[:, 0]]
    return int((np.bincount(piece) > LEAST_PIECE * len(mesh.faces)).sum())
