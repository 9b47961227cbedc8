"""Rivals of the product: the same network in torch, the floor of its operations, and a clip in Newton's simulator.

The first two stand beside the packed graph in ``benchmarks.latency``, the simulator beside the service in
``benchmarks.tradeoff``.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.clock import timed
from benchmarks.harness import ROOT
from benchmarks.judge.physics import Held
from benchmarks.tables import Row
from drape.arrays.subnormals import flushed
from drape.body.model import BodyModel
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
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

NEWTON_LIMIT_S = 3600
NEWTON_CONTACT_N_PER_M, NEWTON_CONTACT_KD = 1300.0, 1e-2


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
    torch.set_num_threads(threads)
    a, b = torch.rand(1024, 1024), torch.rand(1024, 1024)
    gemm = 1024**3 / (1e-3 * timed(lambda: a @ b, seconds=1.0).p50_ms)
    source = torch.rand(1 << 24)
    target = torch.empty_like(source)
    copy = 2 * source.nbytes / (1e-3 * timed(lambda: target.copy_(source), seconds=1.0).p50_ms)
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


def newton_runs(python: str | None, scene: dict[str, Any]) -> dict[str, np.ndarray] | str:
    """What ``benchmarks.speed.newton_vbd`` finds of ``scene`` in the interpreter ``python``, or why nothing."""
    if python is None:
        return "no interpreter with newton: give --newton PYTHON"
    with tempfile.TemporaryDirectory() as folder:
        path, out = Path(folder) / "scene.npz", Path(folder) / "out.npz"
        np.savez(path, **scene)
        command = [python, str(ROOT / "benchmarks/speed/newton_vbd.py"), str(path), str(out)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=NEWTON_LIMIT_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            return type(error).__name__
        if done.returncode:
            lines = done.stderr.strip().splitlines() or ["no message"]
            return lines[-1][:160]
        with np.load(out) as found:
            return {name: found[name] for name in found.files}


def newton_cloth(cloth: Material) -> dict[str, Any]:
    """``cloth`` as Newton knows it, whose membrane is isotropic: ``membrane`` (mu) and ``area`` (lambda) [N/m].

    They are those of the isotropic cloth nearest to ours, which is ours averaged over the directions that its warp
    could have: an isotropic one keeps its own. Bending is averaged too, which leaves ``bending_j`` of the harmonics.
    """
    warp, weft, cross, shear = cloth.membrane
    return {
        "membrane": (warp + weft - 2.0 * cross + shear) / 8.0,
        "area": (warp + weft + 6.0 * cross - shear) / 8.0,
        "bending": cloth.bending_j,
        "density": cloth.density_kg_m2,
    }


@dataclass(frozen=True, eq=False)
class NewtonClip:
    """A clip for Newton: ``cloth`` of ``friction`` that starts at ``start`` [m] (V, 3) and is at rest in ``mesh``, over
    bodies ``body_vertices`` [m] (F, B, 3) at ``fps``, and is ``held`` at its waist where it has one.

    Sheets, hinges and their stiffness by direction are ours; the membrane is isotropic (``newton_cloth``). Contact
    begins at our distance, with 1,300 N/m, and the skin's speed is told
    to friction. What was tried, on a T-shirt in jersey in its sixth frame of the walk, as energy [J], of which physics
    has 0.04 and skinning 1.09. Sweeps: 8 steps of 10 iterations 0.72, 16 of 5 0.24, 32 of 3 0.14, 32 of 1 0.38, 16 of 2
    1.09, 8 of 2 3.9. Contact in 8 steps of 10: our own 70 N/m 0.99; in 32 of 3: 10,000 N/m 0.14, begun at 6 mm 0.13,
    without friction 0.15. The fabric's damping hinders convergence: 5.7 for the 0.99.
    """

    mesh: ClothMesh
    rest: np.ndarray
    start: np.ndarray
    cloth: Material
    friction: float
    body_faces: np.ndarray
    body_vertices: np.ndarray
    fps: float
    held: Held | None = None

    def scene(self, paces: Sequence[tuple[int, int]]) -> dict[str, Any]:
        """What ``benchmarks.speed.newton_vbd`` reads; ``paces`` are steps and iterations of a frame."""
        frames, held, mesh = len(self.body_vertices), self.held, self.mesh
        along, *turned = self.cloth.bending
        return {
            "rest": self.rest, "faces": self.mesh.faces, "start": self.start, "paces": np.array(paces),
            "body_faces": self.body_faces, "body_vertices": self.body_vertices, "fps": self.fps,
            "pinned": np.zeros(0, int) if held is None else held.vertex,
            "anchor": np.zeros((frames, 0, 3)) if held is None else held.anchor,
            "radius": self.cloth.contact_gap_m, "friction": self.friction, **newton_cloth(self.cloth),
            "contact_ke": NEWTON_CONTACT_N_PER_M, "contact_kd": NEWTON_CONTACT_KD,
            "inverse_shape": mesh.inverse_shape, "face_area": mesh.face_area, "vertex_kg": mesh.vertex_mass(self.cloth),
            "hinge_edge": np.asarray(mesh.hinge_index).reshape(4, -1)[:2].T,
            "hinge_j": mesh.hinge_weight * (along + mesh.hinge_turn @ np.array(turned)),
            "hinge_angle": np.arctan2(mesh.hinge_sine, mesh.hinge_cosine),
        }  # fmt: skip

    def run(self, python: str | None, paces: Sequence[tuple[int, int]]) -> dict[str, np.ndarray] | str:
        """``vertices`` (P, F, V, 3) and times ``wall_ms``, ``cpu_ms`` (P, F) in ``python``, or why there are none."""
        return newton_runs(python, self.scene(paces))
