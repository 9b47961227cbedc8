"""Charts of the packed graph: jets to posed polynomials, their blend in vertices, and fits to what the blend says."""

from __future__ import annotations

import torch
from torch import Tensor

from drape.garment.cache import CHARTS_PER_VERTEX
from drape.garment.consensus import FIT_COUNT, MEMBERS
from drape.geometry import jets
from drape.graph.packed_inputs import COLUMNS, VERTICES_PER_BLOCK, Indices, StoredCharts
from model_export.packed.kinematics import PatchFrames
from model_export.packed.operators import WithTables

# Rows of (place, 1, u, v, uu, uv, vv) whose products are the basis of orders 3 and 4.
_HIGHER = (6, 6, 8, 8, 6, 6, 7, 7, 8), (4, 5, 4, 5, 6, 7, 7, 8, 8)


class ChartConsensus(WithTables):
    """A module without weights that blends the charts of each vertex, and fits each chart to that blend."""

    def __init__(self) -> None:
        super().__init__(_chart_tables())

    def posed(self, frames: PatchFrames, jet: Tensor) -> Tensor:
        """Returns matrices (P, 3, 18) that take a column, a rest place [patch scales] (3) and the basis there (15), to
        a posed place [m] relative to the root joint. ``jet`` (P, 27 or 45) [patch scales] is the change of the rest
        jets in ``frames``."""
        placed = self.placed_full if jet.shape[-1] == jets.FULL_COUNT else self.placed
        return frames.out @ torch.addmm(self.frame_only, jet, placed).reshape(-1, 4, COLUMNS)

    def agreed(self, places: Tensor, stored: StoredCharts, index: Indices, frames: PatchFrames) -> Tensor:
        """Returns changes (P, 27) [patch scales] of the rest jets with which each chart fits the blend of all, as
        ``training.chart_consensus.agreed_jets`` does.

        ``places`` (P, 3, 56) [m] are those that each chart gives its anchors, times the chart's weight there.
        """
        return self._fitted(places, stored, index, frames, self.fit_choice)

    def closed(self, places: Tensor, stored: StoredCharts, index: Indices, frames: PatchFrames) -> Tensor:
        """Returns changes (P, 45) [patch scales] of the full rest jets with which each chart fits the blend of all, as
        ``training.chart_consensus.closing_jets`` does. ``places`` are those of ``agreed``."""
        return self._fitted(places, stored, index, frames, self.full_choice)

    def _fitted(
        self, places: Tensor, stored: StoredCharts, index: Indices, frames: PatchFrames, choice: Tensor
    ) -> Tensor:
        """Jets fitted to the blend; ``choice`` picks their coefficients among the 63."""
        assert index.anchor_charts is not None and index.member_anchor is not None
        anchors = self._blended(places, index.anchor_charts)
        # Coordinates first: three rows of many columns, the shape that small products and differences are fast in.
        members = torch.index_select(anchors, 1, index.member_anchor.reshape(-1)).reshape(3, -1, MEMBERS)
        local = frames.into.mT @ ((members.transpose(0, 1) - frames.centre) @ stored.fit)
        # Picked by a product: a Gather of columns takes three times as long.
        return torch.addmm(stored.rest @ choice, local.reshape(-1, 3 * FIT_COUNT), choice, beta=-1)

    def columns(self, stored: Tensor) -> Tensor:
        """Returns columns (P, 18, 56) of the anchors of each chart: rest place and basis up to the fourth order, times
        the chart's weight w. ``stored`` (P, 9, 56) ends at the second order; the others are (w a) (w b) / w = w a b."""
        weight = torch.clamp(stored[:, 3:4], min=1e-30)
        higher = torch.index_select(stored, 1, self.higher_first) * torch.index_select(stored, 1, self.higher_second)
        return torch.cat([stored, higher / weight], dim=1)

    def _blended(self, places: Tensor, charts: Tensor) -> Tensor:
        """Sums (3, n) of the weighted ``places`` (Q, 3, columns) over the four ``charts`` (4, ...) of n points."""
        columns = places.transpose(0, 1).reshape(3, -1)
        of_points = torch.index_select(columns, 1, charts.reshape(-1))
        return self.chart_sums @ of_points.reshape(3 * CHARTS_PER_VERTEX, -1)

    def blend(self, coefficients: Tensor, columns: Tensor, vertex_charts: Tensor) -> Tensor:
        """Returns vertices [m] (blocks, 64, 3) relative to the root joint: sums over the charts ``vertex_charts``
        (4, blocks, 64) of each vertex, which are columns of the tiles ``coefficients`` (Q, 3, 18) @ ``columns``
        (Q, 18, 32)."""
        return self._blended(coefficients @ columns, vertex_charts).mT.reshape(-1, VERTICES_PER_BLOCK, 3)


def _chart_tables() -> dict[str, Tensor]:
    """Returns the constant matrices that ``ChartConsensus`` multiplies with, by the names of its buffers."""
    return {
        **_jet_tables(),
        "chart_sums": torch.kron(torch.eye(3), torch.ones(1, CHARTS_PER_VERTEX)),
        "higher_first": torch.tensor(_HIGHER[0]),
        "higher_second": torch.tensor(_HIGHER[1]),
    }


def _jet_columns(plane: int) -> list[int]:
    """Places of a jet's numbers, ``plane`` of them of each in-plane polynomial, among the 4 x 18."""
    counts = (plane, plane, jets.HEIGHT_COUNT)
    return [row * COLUMNS + 3 + i for row, count in enumerate(counts) for i in range(count)]


def _jet_tables() -> dict[str, Tensor]:
    """Jets (P, 27) @ ``placed`` + ``frame_only`` is (P, 4 * 18), which multiplies [scaled rotation, centre].

    Its rows are p, q, h and one: columns 0-2 pass the rest place (an identity), 3-17 are the jets; the last row's
    entry 3 adds the centre. ``placed_full`` does the same for full jets (P, 45). ``fit_choice`` (63, 27) and
    ``full_choice`` (63, 45) pick the jets and the full jets among the 3 x 21 fitted numbers.
    """
    placed, frame_only = torch.zeros(jets.JET_COUNT, 4 * COLUMNS), torch.zeros(1, 4 * COLUMNS)
    placed[torch.arange(jets.JET_COUNT), torch.tensor(_jet_columns(jets.IN_PLANE_COUNT))] = 1.0
    full = torch.zeros(jets.FULL_COUNT, 4 * COLUMNS)
    full[torch.arange(jets.FULL_COUNT), torch.tensor(_jet_columns(jets.HEIGHT_COUNT))] = 1.0
    for axis in range(3):
        frame_only[0, axis * COLUMNS + axis] = 1.0
    frame_only[0, 3 * COLUMNS + 3] = 1.0
    plane = range(jets.HEIGHT_COUNT, FIT_COUNT)
    columns = [*plane, *(FIT_COUNT + i for i in plane), *(2 * FIT_COUNT + i for i in range(jets.HEIGHT_COUNT))]
    full_columns = [FIT_COUNT * axis + i for axis in range(3) for i in range(jets.HEIGHT_COUNT)]
    every = torch.eye(3 * FIT_COUNT)
    return {
        "placed": placed,
        "placed_full": full,
        "frame_only": frame_only,
        "fit_choice": every[:, columns].contiguous(),
        "full_choice": every[:, full_columns].contiguous(),
    }
