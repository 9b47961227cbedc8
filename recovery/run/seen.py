"""What a target shows of its cut: where its openings lie along the body, girths between them, the pieces of a texture.

Places are told along the bones and then counted on the body in its T-pose, where bases are drafted.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.sparse
from scipy.sparse import csgraph

from drape.body.skeleton import JOINT_NAMES
from drape.garment.contours import TRUNK, Contour, bone_chains, open_contours, place_of
from drape.garment.files.mesh import GarmentMesh
from drape.geometry import mesh_graphs, meshes

ROUND = 0.5  # turns of a loop about a point that it encloses
EVEN_STRETCH = 1.25  # of the middle one: within that most triangles of a panel laid out flat differ from each other
LAID_OUT = 0.9  # of the cloth that is so
LEAST_PIECE = 1e-3  # of all faces


@dataclass(frozen=True, eq=False)
class Opening:
    """An opening's ``contour``, and where it lies on the wearer in the T-pose: ``points`` [m] (n, 3), their ``centre``.

    ``along_m`` counts along the bones of its part: from the shoulder or hip of a limb, from the pelvis of the trunk.
    """

    contour: Contour
    points: np.ndarray
    centre: np.ndarray
    along_m: float


class Seen:
    """What is seen of a garment, ``vertices`` [m] (V, 3) and ``faces``, on a wearer whose ``joints`` [m] (24, 3) are
    known in its pose, and at ``rest`` in the T-pose.

    ``openings``: by part of the body, those of the trunk from above.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, rest: np.ndarray) -> None:
        self._vertices, self._faces = vertices, faces
        self._chains, self._rest = bone_chains(joints), bone_chains(rest)
        at = dict(zip(JOINT_NAMES, joints, strict=True))
        self.openings: dict[str, list[Opening]] = {}
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
            found = Opening(contour, contour.points - here + there, centre, place.along_m - root)
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
    """Length [m] of the longest loop round ``point`` (3,) in which a plane across ``normal`` cuts the mesh.

    A loop goes round a point if its angles about it sum to a turn. None where no loop does.
    """
    normal = normal / np.linalg.norm(normal)
    height = (vertices - point) @ normal
    above = height[faces] > 0.0
    cut = faces[above.any(axis=1) & ~above.all(axis=1)]
    if not len(cut):
        return None
    edges = np.sort(np.stack([cut, np.roll(cut, -1, axis=1)], axis=2), axis=2)  # (n, 3 edges, 2 ends)
    up = height[cut] > 0.0
    crossed = up != np.roll(up, -1, axis=1)
    falls = crossed & up  # the way round a triangle crosses the plane once down and once up
    start, end = edges[falls], edges[crossed & ~up]
    key = np.unique(np.concatenate([start, end]), axis=0, return_inverse=True)[1].reshape(2, -1)
    count = int(key.max()) + 1
    links = scipy.sparse.csr_matrix((np.ones(key.shape[1]), (key[0], key[1])), shape=(count, count))
    loop = csgraph.connected_components(links, directed=False)[1][key[0]]

    def crossing(ends: np.ndarray) -> np.ndarray:
        h = height[ends]
        share = (h[:, 0] / (h[:, 0] - h[:, 1]))[:, None]
        return (1.0 - share) * vertices[ends[:, 0]] + share * vertices[ends[:, 1]] - point

    a, b = crossing(start), crossing(end)
    turn = np.arctan2(np.cross(a, b) @ normal, (a * b).sum(axis=1)) / (2.0 * np.pi)
    turns = np.bincount(loop, turn)
    lengths = np.bincount(loop, np.linalg.norm(b - a, axis=1))
    found = lengths[np.abs(turns) > ROUND]
    return float(found.max()) if len(found) else None


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
