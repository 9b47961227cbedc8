"""The floor of the network's time in ``benchmarks.latency``: its multiply-adds and its bytes."""

from __future__ import annotations

from torch import nn

from benchmarks.speed.rates import copied_per_s, multiply_adds_per_s
from benchmarks.tables import Row
from drape.garment.consensus import FIT_COUNT, MEMBERS, STRAIN_POINTS
from drape.geometry import jets
from drape.graph.packed import COLUMNS
from drape.graph.packing import PackedGarment
from model_export.packed.graph import PackedGraph
from training.model import OneFit


def multiply_adds(model: OneFit, garment: PackedGarment) -> float:
    """Multiply-adds of one frame of one garment: network, frames, agreement of charts, strain, and vertex stage."""
    graph = PackedGraph(model)
    linear = [
        m for part in (graph.trunk, graph.head, graph.corrections) for m in part.modules() if isinstance(m, nn.Linear)
    ]
    per_patch = sum(m.weight.numel() for m in linear) + 24 * 16 + 24 * 9 + 3 * 4 * COLUMNS
    per_patch += graph.from_surroundings.numel()
    passes = len(graph.corrections)
    agreed = 3 * 4 * MEMBERS + (passes + 1) * 3 * COLUMNS * MEMBERS
    agreed += (passes + 2) * (3 * FIT_COUNT * MEMBERS + 9 * FIT_COUNT)
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
