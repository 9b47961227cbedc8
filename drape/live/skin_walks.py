"""The graph of a skin's samples, on which a vertex walks and so keeps to its own part of the body.

From the sample that a vertex had in the frame before it walks to the nearest one, always on to the nearest neighbour. A
frame moves a vertex by less than a few samples, so that the walk stays on the part where the vertex was: a sleeve keeps
to its arm where the arm touches the trunk. A vertex without a past starts at the sample that is nearest at rest. The
engine walks (``source/walks.hpp``), and blends the planes below the vertices (``source/skin.hpp``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape.contact.samples import FACING, Samples

NEIGHBOURS = 8
CANDIDATES = 24  # nearest samples that are looked at; those that face another way are left out


class SkinGraph(NamedTuple):
    """The graph of S skin samples: the ``neighbour`` samples (S, 8) of each, itself where there are fewer; ``reach_m2``
    [m^2] (S,), the square of its spacing; ``rest`` [m] (S, 3), its place at rest."""

    neighbour: np.ndarray
    reach_m2: np.ndarray
    rest: np.ndarray

    def of_type(self, dtype: type[np.floating]) -> SkinGraph:
        """Returns the same graph with floats of ``dtype``."""
        return self._replace(reach_m2=self.reach_m2.astype(dtype), rest=self.rest.astype(dtype))


def skin_graph(skin: Samples) -> SkinGraph:
    """Returns the graph of the samples of ``skin``: the neighbours of a sample are the nearest at rest that face its
    way."""
    _, near = KDTree(skin.point).query(skin.point, k=min(CANDIDATES, skin.count))
    facing = np.einsum("snc,sc->sn", skin.normal[near], skin.normal) > FACING
    own = np.arange(skin.count)[:, None]
    order = np.argsort(~facing | (near == own), axis=1, kind="stable")[:, :NEIGHBOURS]
    chosen = np.where(np.take_along_axis(facing, order, axis=1), np.take_along_axis(near, order, axis=1), own)
    return SkinGraph(np.ascontiguousarray(chosen, np.int32), skin.spacing_m**2, skin.point)


def nearest_at_rest(vertices: np.ndarray, skin: Samples) -> np.ndarray:
    """Returns the indices (V,) int32 of the samples of ``skin`` nearest to ``vertices`` [m] (V, 3), both at rest."""
    return np.asarray(KDTree(skin.point).query(vertices)[1], dtype=np.int32)


class TouchedSamples(NamedTuple):
    """For each of P places of cloth, as the network drapes it: ``own`` (P,), the skin sample under it, and ``other``
    (P,), a near sample of another part of the body, -1 where there is none."""

    own: np.ndarray
    other: np.ndarray
