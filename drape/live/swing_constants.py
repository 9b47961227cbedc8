"""Constants of swing: a garment in a fabric on a body, made once for all streams."""

from __future__ import annotations

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric as fabric_named
from drape.cloth.material import Material
from drape.contact.skin import body_skin
from drape.garment.cache import Garment
from drape.live.fold_constants import heights_m
from drape.live.skin_walks import nearest_at_rest, skin_graph
from drape.live.swing_mesh import swing_mesh
from drape.live.swing_slack import held_share
from drape.live.swing_step import SWING_HZ, SwingConstants

HELD_M = 0.008  # cloth that is nearer to the skin at rest never swings
STIFFEST_N_PER_M = 300.0  # a few sweeps cannot follow stiffer cloth


def swing_constants(garment: Garment, body: BodyModel, fabric: Fabric | None = None) -> SwingConstants | None:
    """Returns the constants of swing for the delivered mesh of ``garment`` on ``body``, made of ``fabric`` or else its
    own; None if no cloth hangs freely. It takes a second at most."""
    made_of = fabric_named(garment.fabric) if fabric is None else fabric
    material, count, skin = Material.of(made_of), garment.vertex_count, body_skin(body)
    rest = garment.vertices[:count].astype(np.float64)
    cloth = ClothMesh.of(garment.delivered_rest(), garment.faces.astype(np.int64), count)
    nearest = nearest_at_rest(rest, skin)
    mesh = swing_mesh(cloth, material, rest, heights_m(rest, skin, nearest) < HELD_M)
    if mesh is None:
        return None
    dtype = mesh.mass_kg.dtype
    return SwingConstants(
        mesh,
        skin_graph(skin).of_type(dtype.type),
        nearest[mesh.vertex],
        min(0.5 * (made_of.warp_n_per_m + made_of.weft_n_per_m), STIFFEST_N_PER_M),
        made_of.damping_s * (2.0 * np.pi * SWING_HZ) ** 2,
        held_share(cloth, rest, skin.point)[mesh.vertex].astype(dtype),
    )
