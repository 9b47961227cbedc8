"""python -m model_export.polyfit [CHECKPOINT] [TARGET]: PolyFit's orientation network as a model folder of its own.

``polyfit.onnx`` takes points of patches in their canonical frames (``drape.garment.canonical``) and gives the
quaternion that turns each for the fit; any number of patches and points. Written only when ONNX Runtime agrees
with torch.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from drape.artifacts import MODELS_DIR, Manifest, TensorSpec, staged_folder
from drape.errors import ArtifactError, refusing
from drape.garment.canonical import Transform, canonical
from model_export.export import commit
from model_export.onnx_file import write_graph
from model_export.parity import check_parity, session
from training.polyfit.families import FAMILIES, draw_patches
from training.polyfit.network import Qstn
from training.polyfit.train import load, load_model

GRAPH = "polyfit"
INPUTS = (TensorSpec("points", ("patches", "points", 3), "float32", "patch sizes"),)
OUTPUTS = (TensorSpec("quaternion", ("patches", 4), "float32", "wxyz"),)
TOLERANCE = 1e-5  # on a quaternion's component
CHECKED_SHAPES = ((1, 4), (3, 64), (170, 91))


class OrientGraph(nn.Module):
    """Points of patches -> quaternions."""

    def __init__(self, model: Qstn) -> None:
        super().__init__()
        self.model = model

    def forward(self, tensors: dict[str, Tensor]) -> Tensor:
        return self.model(tensors["points"])


def runtime_transform(file: Path) -> Transform:
    """The exported network as a function, for ``drape.garment.canonical.polyfit_orient``."""
    run = session(file)
    return lambda points: np.asarray(run.run(["quaternion"], {"points": points})[0])


def parity_error(model: Qstn, file: Path) -> float:
    """Largest difference of a quaternion's component between torch and ONNX Runtime, over several shapes."""
    transform, worst = runtime_transform(file), 0.0
    for patches, points in CHECKED_SHAPES:
        drawn = draw_patches(patches, points, families=FAMILIES, seed=(patches, points))
        local = canonical(drawn.points).local
        with torch.no_grad():
            expected = model(local).numpy()
        worst = max(worst, float(np.abs(transform(local.numpy()) - expected).max()))
    return worst


def export_polyfit(checkpoint: Path, target: Path) -> Manifest:
    """Writes the folder ``target`` from a checkpoint of ``training.polyfit``; refuses above ``TOLERANCE``."""
    model = load_model(checkpoint)
    if not isinstance(model, Qstn):
        raise ArtifactError(
            f"checkpoint {checkpoint.name}", expected="a quaternion transformer", got=type(model).__name__,
            cure="Export finetuned.pt or families.pt.",
        )  # fmt: skip
    state, config = load(checkpoint)
    with staged_folder(target) as staged:
        graph = write_graph(OrientGraph(model), staged / "polyfit.onnx", INPUTS, OUTPUTS)
        error = parity_error(model, staged / graph.file)
        check_parity("parity", error, TOLERANCE, "on a quaternion's component", unit="")
        manifest = Manifest(
            name=target.name, graphs={GRAPH: graph}, body="", body_digest="", embedding_size=0, parity_error_m=error,
            training={
                "steps": int(state["step"]), "patches_seen": int(state["step"]) * config.batch_size,
                "command": f"python -m training.polyfit --only {_only(config.start, checkpoint)}", "commit": commit(),
                "parity_error_unit": "component of a quaternion",
            },
        )  # fmt: skip
        (staged / "manifest.json").write_text(manifest.to_json())
    return manifest


def _only(start: str | None, checkpoint: Path) -> str:
    """The runs that ``checkpoint`` comes from, as the training program names them."""
    return " ".join(name for name in (start, checkpoint.stem) if name)


@refusing
def main() -> int:
    """Command line entry."""
    parser = argparse.ArgumentParser(prog="python -m model_export.polyfit", description="Exports PolyFit.")
    parser.add_argument("checkpoint", type=Path, nargs="?", default=Path("runs/polyfit/finetuned.pt"))
    parser.add_argument("target", type=Path, nargs="?", default=MODELS_DIR / "polyfit")
    options = parser.parse_args()
    manifest = export_polyfit(options.checkpoint, options.target)
    print(f"{options.target}: parity {manifest.parity_error_m:.2e}, digest {manifest.digest[:16]}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
