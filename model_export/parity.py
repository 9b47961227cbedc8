"""Torch against onnxruntime on the same inputs: the largest difference decides whether a model is written at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime
import torch

from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.feeds import body_feed, garment_feed
from drape.garment.cache import Garment
from model_export.graph import DrapeGraph, EncoderGraph, drape_inputs
from training.model import OneFit

TOLERANCE_M = 1e-4


def hard_poses(count: int, *, seed: int = 0) -> np.ndarray:
    """Poses (count, 24, 3) [rad]: the rest pose, strong random ones, and one with half turns."""
    rng = np.random.default_rng(seed)
    poses = rng.normal(0.0, 0.45, size=(count, 24, 3))
    poses[0] = 0.0
    poses[-1] = 0.0
    poses[-1, 16] = [0.0, 0.0, np.pi]
    return poses


def session(path: Path) -> onnxruntime.InferenceSession:
    """A CPU session on ``path`` that says nothing unless something is wrong."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def parity_error(
    model: OneFit, encoder: Path, drape: Path, garment: Garment, *, body: BodyModel | None = None
) -> float:
    """Largest vertex distance [m] between torch and onnxruntime, over frame counts 1, 5, 16 and several shapes."""
    body = load_body() if body is None else body
    encode, run = session(encoder), session(drape)
    features = garment.patch_features
    with torch.no_grad():
        embedding = EncoderGraph(model)(torch.from_numpy(features)).numpy()
    stored = encode.run(None, {"patch_features": features})[0]
    names = [spec.name for spec in drape_inputs(model)]
    worst = 0.0
    for count, scale in ((1, 0.0), (5, 1.0), (16, 2.0)):
        poses = hard_poses(count, seed=count)
        rng = np.random.default_rng(count)
        feed = body_feed(body, poses, np.zeros((count, 3)), scale * rng.normal(size=body.shape_count))
        arrays = feed.arrays | garment_feed(garment) | {"patch_embedding": embedding}
        with torch.no_grad():
            expected = DrapeGraph(model)(**{name: torch.from_numpy(arrays[name]) for name in names})[0].numpy()
        got = run.run(["vertices"], {name: arrays[name] for name in names} | {"patch_embedding": stored})[0]
        worst = max(worst, float(np.linalg.norm(got - expected, axis=-1).max()))
    return worst
