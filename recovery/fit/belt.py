"""Lays the waist of a drape on that of its target, which shows where the wearer's belt is.

Without friction a belt closes at the height where the body is as wide as the waist of the pattern. On hips that widen
by a millimetre a centimetre, or in another simulator, that is centimetres off. A search that may not move the belt
makes up for it with the lengths of the panels.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from drape.cloth.material import OrthotropicMaterial
from recovery.drape.pipeline import Draped
from recovery.drape.settle import settle
from recovery.fit.contours import Contour, Match, open_contours
from recovery.fit.objective import nearest_on_line
from recovery.sim.sdf import SignedDistance


def held_as_target(
    draped: Draped, matches: list[Match], there: list[Contour], skin: SignedDistance, cloth: OrthotropicMaterial
) -> Draped:
    """``draped`` with the nodes that its belt holds laid on the waist among the target's contours ``there``.

    Held nodes move by the offset of both contours' centres, then to the nearest point of the target's. The other nodes
    move by the offset and settle round ``skin``, the body's distance in the drape's pose. Returns ``draped`` itself
    without a belt, without a counterpart, or if the garment does not come to rest so.
    """
    held = draped.rest.held
    if not len(held):
        return draped
    own = open_contours(draped.nodes, draped.mesh.faces)
    waist = next((match for match in matches if np.isin(held, own[match.source].loop).all()), None)
    if waist is None:
        return draped
    line = there[waist.target].points
    nodes = draped.nodes + (there[waist.target].centre - own[waist.source].centre)
    best, t = (part.numpy() for part in nearest_on_line(torch.from_numpy(nodes[held]), torch.from_numpy(line)))
    nodes[held] = line[best] + t[:, None] * (np.roll(line, -1, axis=0) - line)[best]
    settled = settle(draped.mesh, nodes, skin, cloth, held=held)
    if not settled.report.converged:
        return draped
    return replace(draped, rest=settled) if draped.posed is None else replace(draped, posed=settled)
