"""The shipped kind of network on a processor: the engine (``drape.engine``) in place of an inference engine's graphs.

Most of the graphs' hundreds of operations are so small that an inference engine takes longer to begin one than to
compute it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from drape.body.feed import BodyFeed
from drape.body.skeleton import JOINT_COUNT
from drape.graph.blend import Tiles, blend
from drape.graph.packed_inputs import PART_SIZE
from drape.graph.packing import PackedGarment
from drape.inference.graph_names import FIRST, JETS, SKIN
from drape.network.bodies import PosedBody, pose_bodies
from drape.network.dense import OUTPUTS, Layer
from drape.network.drape import checked_jets
from drape.network.garment_encoder import encode_patches, garment_encoder
from drape.network.motion import advance_encoder, motion_encoder
from drape.network.patch_rows import PatchRows, patch_rows
from drape.network.weights import weights_of


def is_covered(network: Mapping[str, Any]) -> bool:
    """Returns whether the engine computes the network that ``network``, an entry of a manifest, describes: one with
    vector jets and corrections, whose ``decoder_sizes`` are multiples of ``dense.OUTPUTS``."""
    whole = all(int(size) % OUTPUTS == 0 for size in network.get("decoder_sizes", (1,)))  # codes are read in whole rows
    return network.get("variant") == "vector" and bool(network.get("corrections")) and whole


class GarmentRows(NamedTuple):
    """The constants of a garment as the engine reads them: ``patches`` for the network, and ``tiles``, by which the
    posed patches are blended into ``vertex_count`` vertices."""

    patches: PatchRows
    tiles: Tiles
    vertex_count: int


class CompiledNetwork:
    """The network on a processor, made of its ``parameters`` by their names and of ``network``, the manifest's
    description of it."""

    def __init__(self, parameters: Mapping[str, np.ndarray], network: Mapping[str, Any]) -> None:
        self.weights = weights_of(parameters, float(network["output_gain"]))
        self.corrections = int(network["corrections"])
        self._garments = garment_encoder(parameters)
        self._motion = motion_encoder(parameters, network) if network.get("dynamic") else None
        self._code_size = int(network["body_code_size"])

    def encode(self, features: np.ndarray) -> np.ndarray:
        """Returns the garment encoder's output (K, n) float32, the packed graph's ``patch_first``, for K patches with
        the ``features`` (K, m) of ``encoder_features``."""
        return encode_patches(self._garments, features)

    def advance(self, features: np.ndarray, state: np.ndarray, dt_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the codes (n, C) and the next recurrent states (n, H) of n moving bodies, for a dynamic network.

        ``features`` (n, 24, 12) are ``motion_features``, ``state`` (n, H) the states before, and ``dt_s`` (n,) [s] the
        times since then, all float32.
        """
        assert self._motion is not None
        code, after = advance_encoder(self._motion, features, state, dt_s)
        return code[:, : self._code_size], after

    def rows(self, garment: PackedGarment) -> GarmentRows:
        """Returns the constants of ``garment`` as the engine reads them."""
        return GarmentRows(patch_rows(garment, garment.stored[FIRST]), Tiles.of(garment), garment.vertex_count)

    def body(self, feed: Mapping[str, np.ndarray], row: int, skin_counts: np.ndarray) -> PosedBody:
        """Returns the posed body in ``row`` of ``feed``, the packed graph's inputs of bodies by name.

        ``skin_counts`` is ``SkinShapes.counts``. A posed skin in ``feed`` is taken as it is; otherwise the bones
        pose it.
        """
        bones = feed["skin_bones"]
        if SKIN in feed:
            skin = np.ascontiguousarray(feed[SKIN][row], np.float32).reshape(-1, 8)
            parts = feed["skin_rows"][0][:0]
        else:
            skin = np.empty((PART_SIZE * len(bones), 8), np.float32)
            parts = feed["skin_rows"][feed["body_shape"][row]]
        code = feed["dynamic_code"][row] if "dynamic_code" in feed else np.empty(0)
        local, rest = feed["joint_quaternion"][row][:JOINT_COUNT], feed["joint_rest"][row]
        given = (local, rest, feed["betas"][row], code)
        local, rest, betas, code = (np.ascontiguousarray(array, np.float32) for array in given)
        return pose_bodies(self.weights, BodyFeed(local, rest, betas, code, parts, bones, skin_counts), skin)

    def drape(
        self, garment: GarmentRows, body: PosedBody, passes: int | None, *, vertices: bool
    ) -> tuple[dict[str, np.ndarray], bool]:
        """Drapes ``garment`` on ``body`` with ``passes`` corrections, None for all. Returns float32 arrays by name, and
        whether all their numbers are finite.

        "jet" (K, 45) [patch scales], "frame_rotation" (K, 3, 3) and "frame_centre" (K, 3) [m] are the posed jets.
        "vertices" [m] are (V, 3), or (0, 3) without ``vertices``. Positions are relative to the root joint.
        """
        count = self.corrections if passes is None else passes
        drawn = np.empty((garment.vertex_count if vertices else 0, 3), np.float32)
        jets, finite = checked_jets(self.weights, garment.patches, body, count, len(garment.tiles.scale))
        if vertices:
            blend(jets, garment.tiles, drawn)
        return dict(zip(JETS, (jets.jet, jets.rotation, jets.centre), strict=True)) | {"vertices": drawn}, finite

    def records(self, garment: GarmentRows, passes: int | None) -> dict[str, Any]:
        """Returns the records "Weights" and "PatchRows", by which a client's engine computes the network for
        ``garment``.

        ``passes``: how many corrections run, None for all. Layers have no tiles of AMX, since browsers have none.
        """
        weights, count = self.weights, self.corrections if passes is None else passes
        layers = {"body": weights.body, "trunk": weights.trunk, "heads": weights.heads}
        corrections = {"first": weights.first[:count], "second": weights.second[:count]}
        several = {name: tuple(map(_untiled, each)) for name, each in (layers | corrections).items()}
        single = {"from_body": _untiled(weights.from_body), "surroundings": _untiled(weights.surroundings)}
        return {"Weights": replace(weights, **several, **single), "PatchRows": garment.patches}


def _untiled(layer: Layer) -> Layer:
    return replace(layer, tiles=np.empty(0, np.uint32))
