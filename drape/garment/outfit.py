"""The garments in a file of several: each is a layer of its own, the innermost first.

A garment is a piece of cloth, or pieces that are sewn to each other, lie on each other, or stand side by side at one
height on both sides of the body, as socks do. What is small belongs to the piece next to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from drape.body.model import BodyModel
from drape.garment.accessories import accessory_of
from drape.garment.cloth_layer import bearing_pieces
from drape.garment.files.mesh import GarmentMesh
from drape.garment.sheets import border_share, with_used_vertices
from drape.geometry import meshes
from drape.geometry.closest import closest_point, on_border

MOST = 4  # layers that an outfit may have
OWN_M2, OWN_SHARE = 0.03, 0.06  # a garment's least area, also over that of the largest piece
SEWN_M, SEWN_SHARE = 0.004, 0.3  # share of a piece's border that lies on another's, if they are sewn
OVER_M = 0.06  # cloth this near over other cloth decides which is the outer one
LEVEL_SHARE = 0.7  # a pair has this share of its height in common
SAMPLES = 400


def garments_in(sheets: GarmentMesh, skin: np.ndarray, body: BodyModel) -> np.ndarray:
    """Returns for each face of ``sheets`` [m] the number (F,) of the garment that it belongs to, from 0, the innermost.
    ``skin`` [m] (S, 3): the vertices of ``body`` in the pose in which it wears them."""
    points, faces = sheets.vertices, sheets.faces
    piece, area, bears = bearing_pieces(points, faces)
    own = bears & (area > max(OWN_M2, OWN_SHARE * area.max()))
    group = np.arange(len(area))
    numbers = np.flatnonzero(own)
    pieces = numbers if len(numbers) > 1 else ()  # a single piece needs no comparison
    carried = {number: bool(accessory_of(sheets.take_faces(piece == number), skin, body)) for number in pieces}
    for i, a in enumerate(numbers):
        for b in numbers[:i]:
            apart = group[a] != group[b] and carried[a] == carried[b]  # a shoe is no sock
            if apart and _one_garment(points, faces[piece == a], faces[piece == b]):
                group[group == group[a]] = group[b]
    while len(np.unique(group[own])) > MOST:
        size = np.bincount(group[own], area[own], minlength=len(group))
        least = int(np.where(size > 0, size, np.inf).argmin())
        own &= group != least
    if not own.any():
        return np.zeros(len(faces), dtype=np.int64)
    held = own[piece]
    middles = points[faces].mean(axis=1)
    near = np.flatnonzero(held)[closest_point(middles[~held], points, faces[held]).face]
    # A piece that is no garment goes as a whole with the one that most of it is next to.
    label = group[piece]
    for number in np.unique(piece[~held]):
        votes = group[piece[near[piece[~held] == number]]]
        label[piece == number] = np.bincount(votes).argmax()
    return _innermost_first(points, faces, label, KDTree(skin))


def parted(mesh: GarmentMesh, sheets: GarmentMesh, label: np.ndarray) -> list[tuple[GarmentMesh, GarmentMesh]]:
    """Returns for each garment, from number 0, its part of the delivered ``mesh`` and its part of ``sheets``
    (``join_sheets``, which may have been moved since). ``label`` (F,): the garment of each face of the sheets, from
    ``garments_in``."""
    if label.max(initial=0) == 0:
        return [(mesh, sheets)]
    count = len(mesh.vertices)
    alone = len(sheets.vertices) == count
    places, middles = sheets.vertices[:count], sheets.vertices[sheets.faces].mean(axis=1)
    near = np.arange(len(mesh.faces)) if alone else KDTree(middles).query(places[mesh.faces].mean(axis=1))[1]
    parts = []
    for number in range(label.max() + 1):
        used, faces = meshes.in_use(mesh.faces[label[near] == number])
        own = replace(mesh.take_faces(label[near] == number), vertices=mesh.vertices[used], faces=faces)
        cut = with_used_vertices(sheets.take_faces(label == number))
        if not alone:
            vertices = np.concatenate([places[used], cut.vertices])
            cut = replace(cut, vertices=vertices, faces=cut.faces + len(used))
        parts.append((own, cut))
    return parts


def part_names(mesh: GarmentMesh, parts: Sequence[GarmentMesh]) -> list[str]:
    """Returns a name for each of the ``parts`` of ``mesh``: the mesh's name, and after it the part's material. If the
    part has several, or another part has it too, the part's number from 1 follows instead. A single part has the mesh's
    name."""
    if len(parts) == 1:
        return [mesh.name]
    used = [np.unique(part.face_material) for part in parts]
    names = []
    for number, own in enumerate(used, start=1):
        unique = len(own) == 1 and sum(own[0] in other for other in used) == 1
        names.append(f"{mesh.name} {mesh.material_names[own[0]] if unique else number}")
    return names


def _one_garment(points: np.ndarray, first: np.ndarray, second: np.ndarray) -> bool:
    """Whether two pieces are sewn to each other, or are a pair."""
    pairs = (first, second), (second, first)
    sewn = any(border_share(points, own, other, SEWN_M, rims=True) > SEWN_SHARE for own, other in pairs)
    return sewn or _paired(points[first], points[second])


def _paired(first: np.ndarray, second: np.ndarray) -> bool:
    low, high = (np.array([one.reshape(-1, 3).min(axis=0), one.reshape(-1, 3).max(axis=0)]) for one in (first, second))
    common = min(low[1, 1], high[1, 1]) - max(low[0, 1], high[0, 1])
    apart = low[1, 0] <= high[0, 0] or high[1, 0] <= low[0, 0]
    return bool(apart and common > LEVEL_SHARE * max(np.ptp(low[:, 1]), np.ptp(high[:, 1])))


def _innermost_first(points: np.ndarray, faces: np.ndarray, label: np.ndarray, skin: KDTree) -> np.ndarray:
    """``label`` (F,) with numbers from 0, so that cloth that lies over other cloth has the higher one."""
    numbers = np.unique(label)
    middles = points[faces].mean(axis=1)
    height = skin.query(middles)[0]
    over = np.zeros((len(numbers), len(numbers)))
    for i, a in enumerate(numbers):
        own = np.flatnonzero(label == a)
        own = own[:: max(1, len(own) // SAMPLES)]
        for j, b in enumerate(numbers):
            if a != b:
                others = np.flatnonzero(label == b)
                found = closest_point(middles[own], points, faces[others])
                near = (found.distance < OVER_M) & ~on_border(found, faces[others])
                over[i, j] = (height[own[near]] - height[others[found.face[near]]]).sum() / len(own)
    rank = (over - over.T).sum(axis=1) + 1e-6 * np.array([height[label == a].mean() for a in numbers])
    place = np.empty(len(numbers), dtype=np.int64)
    place[np.argsort(rank, kind="stable")] = np.arange(len(numbers))
    return place[np.searchsorted(numbers, label)]
