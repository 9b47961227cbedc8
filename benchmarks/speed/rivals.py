"""Rivals of the packed graph in ``benchmarks.latency``: the same network in torch, and the floor."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.clock import timed
from benchmarks.speed.rates import copied_per_s, multiply_adds_per_s
from benchmarks.tables import Row
from drape.arrays.subnormals import flushed
from drape.body.model import BodyModel
from drape.garment.cache import Garment
from drape.garment.consensus import FIT_COUNT, MEMBERS, STRAIN_POINTS
from drape.garment.fabric_features import encoder_features
from drape.geometry import jets
from drape.graph.feeds import garment_feed
from drape.graph.packed import COLUMNS, Indices, PackedBodies, ShapedSkins, StoredPatches
from drape.graph.packing import PackedGarment, Place, compose, pack_body, pack_garment
from drape.graph.push_feed import SkinShapes
from model_export.packed.graph import FirstGraph, PackedGraph
from training.model import OneFit


class EagerDrape(nn.Module):
    """One body and one garment through ``PackedGraph`` in torch: the same constants computed before, vertices only."""

    def __init__(self, model: OneFit, garment: Garment, body: BodyModel) -> None:
        super().__init__()
        self.graph = PackedGraph(model).eval()
        with torch.no_grad():
            features = encoder_features(garment, model.config.encoder_feature_count)
            first = FirstGraph(model)({"patch_features": torch.from_numpy(features)})[1].numpy()
        packed = pack_garment(garment_feed(garment, body=body if model.config.feels_body else None), first)
        shape = SkinShapes(body).feed(pack_body(body).betas[None])
        constants = packed.stored | compose([(packed, Place(0, 0), 0)]).arrays | shape
        arrays = {name: torch.from_numpy(value.copy()) for name, value in constants.items()}
        self.columns = arrays["tile_positions"]
        self.patches, self.index = StoredPatches.from_flat(arrays), Indices.from_flat(arrays)
        self.skins = ShapedSkins.from_flat(arrays) if model.config.feels_body else None

    def forward(self, joint_quaternion: Tensor, joint_rest: Tensor, betas: Tensor) -> Tensor:
        """Vertices (blocks, 64, 3) [m]."""
        posed = self.graph.pose(
            PackedBodies(joint_quaternion, joint_rest, betas, skins=self.skins), self.patches, self.index
        )
        coefficients = torch.index_select(posed.coefficients, 0, self.index.tile_patch)
        return self.graph.charts.blend(coefficients, self.columns, self.index.vertex_charts)


@flushed()
def torch_row(model: OneFit, garment: Garment, body: BodyModel, pose: np.ndarray, *, seconds: float) -> Row:
    """The same model in eager torch."""
    shape = pack_body(body)
    eager = EagerDrape(model, garment, body)

    def call(module: Callable[..., Tensor]) -> Tensor:
        with torch.inference_mode():
            return module(**{k: torch.from_numpy(np.array(v)) for k, v in shape.rows(pose).items()})

    return {"name": "torch_eager", **timed(lambda: call(eager), seconds=seconds).row()}


def multiply_adds(model: OneFit, garment: PackedGarment) -> float:
    """Multiply-adds of one frame of one garment: network, frames, agreement of charts, strain, and vertex stage."""
    graph = PackedGraph(model)
    linear = [
        m for part in (graph.trunk, graph.head, graph.corrections) for m in part.modules() if isinstance(m, nn.Linear)
    ]
    per_patch = sum(m.weight.numel() for m in linear) + 24 * 16 + 24 * 9 + 3 * 4 * COLUMNS
    per_patch += graph.from_surroundings.numel() if graph.from_surroundings is not None else 0
    passes = len(graph.corrections)
    agreed = (3 * 4 * MEMBERS if graph.based else 0) + passes * 3 * COLUMNS * MEMBERS
    agreed += (passes + graph.based) * (3 * FIT_COUNT * MEMBERS + 9 * FIT_COUNT)
    agreed += graph.closes * (3 * COLUMNS * MEMBERS + 3 * FIT_COUNT * MEMBERS + 9 * FIT_COUNT)
    per_patch += agreed + passes * 2 * jets.JET_COUNT * 6 * STRAIN_POINTS
    per_body = sum(p.numel() for p in [*graph.body.parameters(), graph.from_body.weight])
    return per_body + per_patch * garment.patch_count + 3 * garment.stored["tile_positions"].size


def floor_row(model: OneFit, garment: PackedGarment, *, threads: int) -> Row:
    """The larger of multiply-adds over the measured matrix rate and bytes over the measured copy rate."""
    gemm, copy = multiply_adds_per_s(threads), copied_per_s(1 << 27, threads)
    graph = PackedGraph(model)
    weights = sum(p.numel() * 4 for p in graph.parameters())
    moved = weights + garment.bytes + 12 * garment.vertex_count
    compute, memory = 1e3 * multiply_adds(model, garment) / gemm, 1e3 * moved / copy
    return {
        "name": "floor",
        "p50_ms": max(compute, memory),
        "stage_ms": {"compute": compute, "memory": memory},
        "gemm_gflops": 2e-9 * gemm,
        "copy_gb_s": 1e-9 * copy,
    }
