"""The packed graph's network on a processor: compiled kernels (``drape.network``) in place of an inference engine.

Most of the graph's eight hundred operations are so small that an engine takes longer to begin one than to compute it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from drape.body.skeleton import JOINT_COUNT
from drape.graph.blend import Tiles, blend
from drape.graph.packed import PART_SIZE
from drape.graph.packing import PackedGarment
from drape.network.bodies import BodyFeed, PosedBody, posed_body
from drape.network.dense import OUTPUTS
from drape.network.drape import checked_jets
from drape.network.patch_rows import PatchRows, patch_rows
from drape.network.weights import weights_of
from service.graphs.graph_names import FIRST, JETS, SKIN


def is_covered(network: Mapping[str, Any]) -> bool:
    """Whether the kernels compute the ``network`` that a manifest describes: the shipped kind, of whatever size."""
    wanted = ("surroundings", "agreed_base", "closing_fit", "feels_body", "corrections")
    sized = int(network.get("decoder_sizes", (0,))[-1])  # codes are read in whole rows
    return network.get("variant") == "vector" and all(network.get(name) for name in wanted) and not sized % OUTPUTS


class GarmentRows(NamedTuple):
    """The constants of a garment: its ``patches``, and the ``tiles`` of its vertices."""

    patches: PatchRows
    tiles: Tiles
    vertex_count: int


class CompiledNetwork:
    """A network of ``parameters`` by their names, which ``network`` describes. Callers flush subnormal numbers."""

    def __init__(self, parameters: Mapping[str, np.ndarray], network: Mapping[str, Any]) -> None:
        self._weights = weights_of(parameters, float(network["output_gain"]))
        self._corrections = int(network["corrections"])

    def rows(self, garment: PackedGarment) -> GarmentRows:
        """The constants of ``garment`` as the kernels read them."""
        return GarmentRows(patch_rows(garment, garment.stored[FIRST]), Tiles.of(garment), garment.vertex_count)

    def body(self, feed: Mapping[str, np.ndarray], row: int, skin_counts: np.ndarray) -> PosedBody:
        """The body of a ``row`` of ``feed``, which has the packed graph's inputs; its ``skin`` where that is given.
        ``skin_counts``: of ``ShapedSkin``."""
        bones = feed["skin_bones"]
        if SKIN in feed:
            skin = np.ascontiguousarray(feed[SKIN][row], np.float32).reshape(-1, 8)
            parts = feed["skin_rows"][0][:0]
        else:
            skin = np.empty((PART_SIZE * len(bones), 8), np.float32)
            parts = feed["skin_rows"][feed["body_shape"][row]]
        code = feed["dynamic_code"][row] if "dynamic_code" in feed else np.empty(0)
        local, rest = feed["joint_quaternion"][row][:JOINT_COUNT], feed["joint_rest"][row]
        local, rest, betas, code = _plain(local, rest, feed["betas"][row], code)
        return posed_body(self._weights, BodyFeed(local, rest, betas, code, parts, bones, skin_counts), skin)

    def drape(
        self, garment: GarmentRows, body: PosedBody, passes: int | None, *, vertices: bool
    ) -> tuple[dict[str, np.ndarray], bool]:
        """The posed jets of ``garment`` on ``body`` as the packed graph's outputs, with its ``vertices`` where these
        are asked for, and whether they are finite; ``passes`` corrections run, None all of them."""
        count = self._corrections if passes is None else passes
        drawn = np.empty((garment.vertex_count if vertices else 0, 3), np.float32)
        jets, finite = checked_jets(self._weights, garment.patches, body, count, len(garment.tiles.scale))
        if vertices:
            blend(jets, garment.tiles, drawn)
        return {**dict(zip(JETS, jets, strict=True)), "vertices": drawn}, finite


def _plain(*arrays: np.ndarray) -> list[np.ndarray]:
    """Copies, C-contiguous float32: kernels are compiled for arrays that may be written."""
    return [np.array(array, np.float32, order="C") for array in arrays]
