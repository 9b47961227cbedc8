"""What folds need of a garment in a fabric, and of a body: made once, and the same for every stream."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.energies import ClothMesh, contact_n_per_m
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric as fabric_named
from drape.cloth.material import Material
from drape.cloth.rest_state import RestState
from drape.cloth.waistband import STIFFNESS_N_M2, waistband
from drape.contact.samples import Samples
from drape.contact.skin import body_skin
from drape.garment.cache import Garment
from drape.garment.rest_detail import cloth_of, rest_of
from drape.live.room import Near, near_along
from drape.live.sheet import Sheet, sheet
from drape.live.skin_contact import SkinGraph, nearest_at_rest, skin_graph
from drape.live.sweeps import HOLD
from drape.live.whole import Whole, whole

# Without friction a neckline slips over the shoulder within seconds. Of cloth of 0.2 kg/m^2 this holds up the weight
# with 2 mm, past the centimetre that is free: all of it where cloth lies on the skin at rest, the least where it hangs.
LEASH_N_M3 = 1000.0
LYING_M, HANGING_M, LEAST = 0.01, 0.025, 0.03


@dataclass(frozen=True, eq=False)
class Dressed:
    """A ``cloth`` of ``material`` on a body, in the order of its vertices: what constants are made of.

    ``band_n_per_m`` (V,): how stiff a vertex is held within a centimetre of where the network has it, most at a
    waistband; ``graph`` of the body's skin samples, and the nearest one ``index`` (V,) at rest; ``friction`` with it.
    """

    cloth: ClothMesh
    material: Material
    band_n_per_m: np.ndarray
    graph: SkinGraph
    index: np.ndarray
    friction: float = 0.0

    @property
    def springs_n_per_m(self) -> np.ndarray:
        """What steps of the whole cloth know of all that holds a vertex (V,), but for contact: its leash, and where it
        lies on the skin ``HOLD`` of contact's stiffness, for the room that it is held in and for friction."""
        contact = contact_n_per_m(self.cloth, self.material)
        leash = np.maximum(LEASH_N_M3 * self.cloth.vertex_area, np.finfo(float).tiny)  # a vertex may have no area
        lies = np.minimum(self.band_n_per_m / leash, 1.0)
        return self.band_n_per_m + HOLD * lies * contact


@dataclass(frozen=True, eq=False)
class Constants:
    """What the kernels read: tables, the whole's factor, skin; the sample ``index`` (P,) nearest to a place at
    rest; what is ``near`` along the cloth; ``friction`` with the skin."""

    sheet: Sheet
    level: Whole
    graph: SkinGraph
    index: np.ndarray
    near: Near
    friction: float

    @classmethod
    def of(cls, dressed: Dressed, *, dtype: type[np.floating] = np.float32) -> Constants:
        """The arrays of ``dressed``, floats of ``dtype``."""
        made = sheet(dressed.cloth, dressed.material, dressed.band_n_per_m, dtype=dtype)
        level = whole(dressed.cloth, dressed.material, dressed.springs_n_per_m, made)
        graph = dressed.graph._replace(
            reach_m2=dressed.graph.reach_m2.astype(dtype), rest=dressed.graph.rest.astype(dtype)
        )
        return cls(made, level, graph, dressed.index[made.vertex], near_along(dressed.cloth), dressed.friction)

    @property
    def nbytes(self) -> int:
        """Memory of the arrays."""
        return _nbytes((self.sheet, self.level, self.graph, self.index, self.near))


def constants(garment: Garment, body: BodyModel, fabric: Fabric | None = None) -> Constants:
    """The constants of ``garment`` on ``body``, made of ``fabric``, if any, else its own; a third of a second."""
    return Constants.of(dressed(garment, body, fabric))


def dressed(garment: Garment, body: BodyModel, fabric: Fabric | None = None) -> Dressed:
    """The delivered mesh of ``garment`` on ``body``, made of ``fabric``, its own where there is none."""
    count = garment.vertex_count
    vertices, faces = garment.vertices[:count].astype(np.float64), garment.faces.astype(np.int64)
    cloth = ClothMesh.of(delivered_rest(garment), faces, count)
    skin = body_skin(body)
    index = nearest_at_rest(vertices, skin)
    held = leash_n_per_m(vertices, cloth.vertex_area, skin, index)
    band = waistband(vertices, faces, body)
    if band is not None:
        held[band.vertex] += STIFFNESS_N_M2 * band.length_m
    fabric = fabric_named(garment.fabric) if fabric is None else fabric
    return Dressed(
        cloth=cloth,
        material=Material.of(fabric),
        band_n_per_m=held,
        graph=skin_graph(skin),
        index=index,
        friction=fabric.friction,
    )


def leash_n_per_m(vertices: np.ndarray, area: np.ndarray, skin: Samples, index: np.ndarray) -> np.ndarray:
    """How stiff [N/m] (V,) each of ``vertices`` [m] (V, 3) at rest is held past its slack, with ``area`` [m^2] (V,).

    By its height over the sample ``index`` (V,) of ``skin``: what lies on the skin would be held by friction, and what
    hangs is free to hang as its fabric does.
    """
    height_m = ((vertices - skin.point[index]) * skin.normal[index]).sum(axis=1)
    return LEASH_N_M3 * area * np.clip((HANGING_M - height_m) / (HANGING_M - LYING_M), LEAST, 1.0)


def delivered_rest(garment: Garment) -> RestState:
    """The cloth of the delivered triangles without stress: what is stored, where none of them was subdivided."""
    count = garment.vertex_count
    if len(garment.vertices) == count:
        return garment.rest_state()
    painted, materials = (garment.uv, garment.uv_faces), (garment.material_names, garment.face_material)
    return rest_of(cloth_of(garment.vertices[:count], garment.faces, painted, materials))[0]


def _nbytes(value: object) -> int:
    if isinstance(value, np.ndarray):
        return value.nbytes
    return sum(map(_nbytes, value)) if isinstance(value, tuple) else 0
