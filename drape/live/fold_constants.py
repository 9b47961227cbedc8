"""Constants of folds: a garment in a fabric on a body, made once for all streams."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.energies import ClothMesh, contact_n_per_m
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric as fabric_named
from drape.cloth.material import Material
from drape.cloth.waistband import STIFFNESS_N_M2, waistband
from drape.contact.samples import Samples
from drape.contact.skin import body_skin
from drape.engine.packer import Recorded
from drape.garment.cache import Garment
from drape.geometry import meshes
from drape.live.room import SheetNeighbours, sheet_neighbours
from drape.live.sheet import Sheet, sheet
from drape.live.skin_walks import SkinGraph, nearest_at_rest, skin_graph
from drape.live.untangle import Tangles, tangles_of
from drape.live.whole import StiffnessFactor, stiffness_factor

# The leash holds a vertex within a centimetre of the network's place: without one a neckline slips over the shoulder
# within seconds. On cloth of 0.2 kg/m^2 it carries the weight 2 mm past that centimetre. Cloth that lies on the skin at
# rest has all of it, cloth that hangs has the least.
LEASH_N_M3 = 1000.0
LYING_M, HANGING_M, LEAST = 0.01, 0.025, 0.03
# Planes of physics stand off the skin that is seen by 0.2 to 0.3 mm in the mean, those of samples do not. So contact
# begins so much farther out than in the energy of cloth, and a little more because steps are few.
INSIDE_M = 0.0004
HOLD = 0.4  # the share of contact's stiffness that steps of the whole allow leash and friction


@dataclass(frozen=True, eq=False)
class WornCloth:
    """A cloth of V vertices on a body, from which the engine's constants are made.

    ``band_n_per_m`` [N/m] (V,) is the stiffness of the spring that holds a vertex within a centimetre of where the
    network has it, the largest at a waistband. ``graph`` are the body's skin samples, ``index`` (V,) the one nearest to
    each vertex at rest, and ``friction`` is the coefficient between cloth and skin.
    """

    cloth: ClothMesh
    material: Material
    band_n_per_m: np.ndarray
    graph: SkinGraph
    index: np.ndarray
    friction: float = 0.0

    @property
    def springs_n_per_m(self) -> np.ndarray:
        """The stiffness [N/m] (V,) of the springs that hold vertices in steps of the whole cloth, without that of
        contact.

        It is ``band_n_per_m`` and, for cloth that friction holds on the skin, ``HOLD`` times contact's stiffness. The
        second part is smaller where ``band_n_per_m`` is less than the full leash.
        """
        contact = contact_n_per_m(self.cloth, self.material)
        leash = np.maximum(LEASH_N_M3 * self.cloth.vertex_area, np.finfo(float).tiny)  # a vertex may have no area
        lies = np.minimum(self.band_n_per_m / leash, 1.0)
        return self.band_n_per_m + HOLD * lies * contact


@dataclass(frozen=True, eq=False)
class LaidCloth(Recorded):
    """The constants of a cloth that garments over and below it read: its ``sheet``, the skin's ``graph``, and ``index``
    (P,), the sample nearest to each place of the sheet at rest."""

    sheet: Sheet
    graph: SkinGraph
    index: np.ndarray

    @property
    def dtype(self) -> np.dtype:
        """The dtype of the sheet's floats, float32 or float64."""
        return self.sheet.own.dtype


@dataclass(frozen=True, eq=False)
class FoldConstants(Recorded):
    """The constants of folds of one cloth as the engine reads them: its ``sheet`` of P places, the ``factor`` of its
    stiffness, and the skin's ``graph``.

    ``neighbours`` are the vertices that lie near each along the cloth; ``index`` (P,) is the sample nearest to each
    place at rest; ``friction`` is the coefficient between cloth and skin. ``hem`` (H, 3) are the places of border
    vertices, each between its neighbours along the border. ``tangles`` are the triangles that may cross.
    """

    sheet: Sheet
    factor: StiffnessFactor
    graph: SkinGraph
    neighbours: SheetNeighbours
    index: np.ndarray
    friction: float
    hem: np.ndarray
    tangles: Tangles

    @classmethod
    def of(cls, worn: WornCloth, *, dtype: type[np.floating] = np.float32) -> FoldConstants:
        """Returns the constants of ``worn``, floats of ``dtype``."""
        tables = sheet(worn.cloth, worn.material, worn.band_n_per_m, dtype=dtype)
        factor = stiffness_factor(worn.cloth, worn.material, worn.springs_n_per_m, tables)
        neighbours = sheet_neighbours(worn.cloth)
        hem = hem_places(worn.cloth.faces, tables.place)
        tangles = tangles_of(worn.cloth.faces, tables.place)
        graph, index = worn.graph.of_type(dtype), worn.index[tables.vertex]
        return cls(tables, factor, graph, neighbours, index, worn.friction, hem, tangles)

    @property
    def nbytes(self) -> int:
        """The memory of the arrays, in bytes."""
        return array_bytes(self)

    @cached_property
    def laid(self) -> LaidCloth:
        """The constants that garments over and below the cloth read."""
        return LaidCloth(self.sheet, self.graph, self.index)


def hem_places(faces: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Returns for every border vertex of ``faces`` the places (H, 3) int32 of the vertex before it along the border,
    its own, and that of the vertex after it. ``place`` (V,) is the place of each vertex in a sheet."""
    loops = [loop for loop in meshes.boundary_loops(faces) if len(loop) > 2]
    triples = [np.stack([np.roll(loop, 1), loop, np.roll(loop, -1)], axis=1) for loop in loops]
    return place[np.concatenate([np.zeros((0, 3), np.int64), *triples])].astype(np.int32)


def fold_constants(garment: Garment, body: BodyModel, fabric: Fabric | None = None) -> FoldConstants:
    """Returns the constants of folds for ``garment`` on ``body``, made of ``fabric`` or else its own. It takes a third
    of a second."""
    return FoldConstants.of(worn_cloth(garment, body, fabric))


def worn_cloth(garment: Garment, body: BodyModel, fabric: Fabric | None = None) -> WornCloth:
    """Returns the delivered mesh of ``garment`` as a cloth on ``body``, made of ``fabric`` or else its own."""
    count = garment.vertex_count
    vertices, faces = garment.vertices[:count].astype(np.float64), garment.faces.astype(np.int64)
    cloth = ClothMesh.of(garment.delivered_rest(), faces, count)
    return worn_mesh(cloth, vertices, body, fabric_named(garment.fabric) if fabric is None else fabric)


def worn_mesh(cloth: ClothMesh, vertices: np.ndarray, body: BodyModel, fabric: Fabric) -> WornCloth:
    """Returns ``cloth`` on ``body``, made of ``fabric``; ``vertices`` [m] (V, 3) are its places at rest on the body in
    T-pose."""
    skin = body_skin(body)
    index = nearest_at_rest(vertices, skin)
    springs = leash_n_per_m(vertices, cloth.vertex_area, skin, index)
    band = waistband(vertices, cloth.faces, body)
    if band is not None:
        springs[band.vertex] += STIFFNESS_N_M2 * band.length_m
    material = Material.of(fabric)
    outside = replace(material, contact_gap_m=material.contact_gap_m + INSIDE_M)
    return WornCloth(cloth, outside, springs, skin_graph(skin), index, fabric.friction)


def heights_m(vertices: np.ndarray, skin: Samples, index: np.ndarray) -> np.ndarray:
    """Returns the heights [m] (V,) of ``vertices`` [m] (V, 3) over the tangent planes of the samples ``index`` (V,) of
    ``skin``, all at rest; negative below."""
    return ((vertices - skin.point[index]) * skin.normal[index]).sum(axis=1)


def leash_n_per_m(vertices: np.ndarray, area: np.ndarray, skin: Samples, index: np.ndarray) -> np.ndarray:
    """Returns the stiffness [N/m] (V,) of the leash, the spring that holds a vertex within a centimetre of where the
    network has it, for ``vertices`` [m] (V, 3) at rest with the areas ``area`` [m^2] (V,).

    It falls with the height of a vertex over the sample ``index`` (V,) of ``skin``: friction would hold what lies
    there, and what hangs is free to hang as its fabric does.
    """
    height_m = heights_m(vertices, skin, index)
    return LEASH_N_M3 * area * np.clip((HANGING_M - height_m) / (HANGING_M - LYING_M), LEAST, 1.0)


def array_bytes(value: object) -> int:
    """Returns the memory in bytes of all arrays in ``value``: an array, or a tuple or dataclass, nested or not."""
    if isinstance(value, np.ndarray):
        return value.nbytes
    if is_dataclass(value):
        value = tuple(getattr(value, field.name) for field in fields(value))
    return sum(map(array_bytes, value)) if isinstance(value, tuple) else 0
