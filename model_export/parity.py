"""Torch against onnxruntime on the same inputs: the largest difference decides whether a model is written at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime
import torch

from drape.arrays.subnormals import flushed
from drape.artifacts import GraphSpec
from drape.body.assets import load_body
from drape.body.features import motion_features
from drape.errors import ArtifactError
from drape.garment.cache import Garment
from drape.garment.fabric_features import encoder_features
from drape.graph.feeds import body_feed, garment_feed, kinematics, skinning_feed
from model_export.graph import DrapeGraph, DynamicGraph, EncoderGraph, drape_inputs
from training.model import OneFit

TOLERANCE_M = 1e-4
SEQUENCE_FRAMES = 30
FIND = "Do not ship this export; find the operator that differs."


def check_parity(name: str, error: float, largest: float, between: str, *, cure: str = FIND) -> None:
    """Refuses (``ArtifactError``) an ``error`` of ``name`` above ``largest``, and one that is no number."""
    if not error <= largest:
        raise ArtifactError(name, expected=f"at most {largest} m {between}", got=f"{error:.3g} m", cure=cure)


def hard_poses(count: int, *, seed: int = 0) -> np.ndarray:
    """Poses (count, 24, 3) [rad]: the rest pose, strong random ones, and one with half turns."""
    rng = np.random.default_rng(seed)
    poses = rng.normal(0.0, 0.45, size=(count, 24, 3))
    poses[0] = 0.0
    poses[-1] = 0.0
    poses[-1, 16] = [0.0, 0.0, np.pi]
    return poses


def session(path: Path) -> onnxruntime.InferenceSession:
    """A CPU session on ``path``, quiet unless something is wrong, in whose threads subnormal numbers are zero."""
    options = onnxruntime.SessionOptions()
    options.add_session_config_entry("session.set_denormal_as_zero", "1")
    options.log_severity_level = 3
    with flushed():
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


@flushed()
def parity_error(model: OneFit, encoder: Path, drape: Path, garment: Garment) -> float:
    """Largest vertex distance [m] between torch and onnxruntime, over frame counts 1, 5, 16 and several shapes."""
    body = load_body()
    encode, run = session(encoder), session(drape)
    features = encoder_features(garment, model.config.encoder_feature_count)
    with torch.no_grad():
        embedding = EncoderGraph(model)({"patch_features": torch.from_numpy(features)}).numpy()
    stored = encode.run(None, {"patch_features": features})[0]
    names = [spec.name for spec in drape_inputs(model)]
    worst = 0.0
    for count, scale in ((1, 0.0), (5, 1.0), (16, 2.0)):
        poses = hard_poses(count, seed=count)
        rng = np.random.default_rng(count)
        feed = body_feed(body, poses, np.zeros((count, 3)), scale * rng.normal(size=body.shape_count), skin=True)
        arrays = (
            feed.arrays
            | garment_feed(garment, body=body)
            | skinning_feed(garment, body)
            | {"patch_embedding": embedding}
        )
        # For a dynamic model: any code of the size that motion makes.
        arrays["dynamic_code"] = rng.normal(0.0, 0.3, size=(count, model.config.body_code_size)).astype(np.float32)
        with torch.no_grad():
            expected = DrapeGraph(model)({name: torch.from_numpy(arrays[name]) for name in names})[0].numpy()
        got = run.run(["vertices"], {name: arrays[name] for name in names} | {"patch_embedding": stored})[0]
        worst = max(worst, float(np.linalg.norm(got - expected, axis=-1).max()))
    return worst


@flushed()
def sequence_error(model: OneFit, folder: Path, graphs: dict[str, GraphSpec], garment: Garment) -> float:
    """Largest vertex distance [m] along a motion with uneven steps and a stop, each side carrying its own state."""
    body = load_body()
    rng = np.random.default_rng(3)
    dt_s = rng.choice([1 / 60, 1 / 30, 1 / 12], size=SEQUENCE_FRAMES - 1)
    time_s = np.concatenate([[0.0], np.cumsum(dt_s)])
    time_s = np.minimum(time_s, time_s[-6])  # of the body, which stands still at the end
    swing = rng.uniform(0.5, 3.0, size=(24, 3))
    poses = 0.4 * np.sin(2.0 * np.pi * time_s[:, None, None] * swing)
    trans = np.sin(3.0 * time_s)[:, None] * [0.5, 0.1, 0.8]
    feed = body_feed(body, poses, trans, skin=True)
    at = kinematics(body, poses, trans)
    features = motion_features(at[2:], at[1:-1], at[:-2], dt_s[1:], dt_s[:-1]).astype(np.float32)
    constants = garment_feed(garment, body=body) | skinning_feed(garment, body)
    with torch.no_grad():
        described = encoder_features(garment, model.config.encoder_feature_count)
        embedding = EncoderGraph(model)({"patch_features": torch.from_numpy(described)}).numpy()
    advance, run = session(folder / graphs["dynamic_encoder"].file), session(folder / graphs["drape"].file)
    names = [spec.name for spec in drape_inputs(model)]
    states = [np.zeros((1, model.config.state_size), dtype=np.float32)] * 2
    encode, worst = DynamicGraph(model), 0.0
    for frame in range(SEQUENCE_FRAMES - 2):
        moved = {"motion_features": features[frame : frame + 1], "dt_s": dt_s[frame + 1 : frame + 2].astype(np.float32)}
        arrays = {key: value[frame + 2 : frame + 3] for key, value in feed.arrays.items()}
        arrays |= constants | {"patch_embedding": embedding}
        with torch.no_grad():
            inputs = {**moved, "state": states[0]}
            code, states[0] = (x.numpy() for x in encode({name: torch.from_numpy(x) for name, x in inputs.items()}))
            tensors = {name: torch.from_numpy((arrays | {"dynamic_code": code})[name]) for name in names}
            expected = DrapeGraph(model)(tensors)[0].numpy()
        code, states[1] = map(np.asarray, advance.run(["dynamic_code", "next_state"], {**moved, "state": states[1]}))
        got = run.run(["vertices"], {name: (arrays | {"dynamic_code": code})[name] for name in names})[0]
        worst = max(worst, float(np.linalg.norm(got - expected, axis=-1).max()))
    return worst
