"""Torch against onnxruntime on the same inputs: the largest difference decides whether a model is written at all.

The readable graphs run over frames and along a motion, the packed graph over one mixed batch. The graphs of the
push-out are compared with NumPy, on skinned garments in hard poses.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime
import torch

from drape.arrays.subnormals import flushed
from drape.artifacts import GraphSpec
from drape.body.assets import load_body
from drape.body.features import motion_features
from drape.contact.projection import CLEARANCE_M, push_out
from drape.contact.skin import body_skin
from drape.errors import ArtifactError
from drape.garment.cache import Garment
from drape.garment.fabric_features import encoder_features
from drape.geometry.skinning import skin_points
from drape.graph.feeds import body_feed, garment_feed, kinematics, skinning_feed
from drape.graph.layer_feed import inner_garment, pack_layer, push_over
from drape.graph.packing import Place, compose_garments, pack_body, pack_garment
from drape.graph.push_feed import SkinShapes, pack_push
from model_export.push.push_graphs import Drapes, LayerTensors, PushTensors
from model_export.readable_graphs import DrapeGraph, DynamicGraph, EncoderGraph, drape_inputs
from training.onefit import OneFit

TOLERANCE_M = 1e-4
SEQUENCE_FRAMES = 30
FIND = "Do not ship this export; find the operator that differs."


def check_parity(name: str, error: float, largest: float, between: str, *, cure: str = FIND) -> None:
    """Raises ``ArtifactError`` where ``error`` [m] is above ``largest`` [m] or NaN. Its message says of what (``name``)
    and ``between`` which two, and the ``cure``."""
    if not error <= largest:
        raise ArtifactError(name, expected=f"at most {largest} m {between}", got=f"{error:.3g} m", cure=cure)


def parity_poses(count: int, *, seed: int = 0) -> np.ndarray:
    """Returns poses (count, 24, 3) [rad]: the rest pose first, last the rest pose with the left shoulder turned by half
    a turn, and between them random ones, drawn from ``seed`` with a deviation of 0.45 rad."""
    rng = np.random.default_rng(seed)
    poses = rng.normal(0.0, 0.45, size=(count, 24, 3))
    poses[0] = 0.0
    poses[-1] = 0.0
    poses[-1, 16] = [0.0, 0.0, np.pi]
    return poses


def session(path: Path) -> onnxruntime.InferenceSession:
    """Returns an ONNX Runtime session of the graph at ``path`` on the processor. It logs errors alone, and subnormal
    numbers are zero in its threads."""
    options = onnxruntime.SessionOptions()
    options.add_session_config_entry("session.set_denormal_as_zero", "1")
    options.log_severity_level = 3
    with flushed():
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


@flushed()
def parity_error(model: OneFit, encoder: Path, drape: Path, garment: Garment) -> float:
    """Returns the largest distance [m] of a vertex between the drape of torch and that of ONNX Runtime, over batches of
    1, 5 and 16 poses, each batch on a body shape of its own."""
    body = load_body()
    encode, run = session(encoder), session(drape)
    features = encoder_features(garment, model.config.encoder_feature_count)
    with torch.no_grad():
        embedding = EncoderGraph(model)({"patch_features": torch.from_numpy(features)}).numpy()
    stored = encode.run(None, {"patch_features": features})[0]
    names = [spec.name for spec in drape_inputs(model)]
    worst = 0.0
    for count, scale in ((1, 0.0), (5, 1.0), (16, 2.0)):
        poses = parity_poses(count, seed=count)
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
        draped = run.run(["vertices"], {name: arrays[name] for name in names} | {"patch_embedding": stored})[0]
        worst = max(worst, float(np.linalg.norm(draped - expected, axis=-1).max()))
    return worst


@flushed()
def sequence_error(model: OneFit, folder: Path, graphs: dict[str, GraphSpec], garment: Garment) -> float:
    """Returns the largest distance [m] of a vertex between torch and ONNX Runtime along a motion with uneven time steps
    and a stop. Each of the two goes on from a recurrent state of its own."""
    body = load_body()
    rng = np.random.default_rng(3)
    dt_s = rng.choice([1 / 60, 1 / 30, 1 / 12], size=SEQUENCE_FRAMES - 1)
    time_s = np.concatenate([[0.0], np.cumsum(dt_s)])
    time_s = np.minimum(time_s, time_s[-6])  # the body stands still at the end
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
        draped = run.run(["vertices"], {name: (arrays | {"dynamic_code": code})[name] for name in names})[0]
        worst = max(worst, float(np.linalg.norm(draped - expected, axis=-1).max()))
    return worst


BATCH_FRAMES = 5


@flushed()
def packed_parity_error(model: OneFit, encoder: Path, packed: Path, garment: Garment) -> float:
    """Returns the largest distance [m] of a vertex between the packed graph in ONNX Runtime and the readable one in
    torch, in one mixed batch: poses of two body shapes, and the garment whole, as its first half and as its first
    hundredth of the vertices."""
    body = load_body()
    feeds = [_first_vertices(garment_feed(garment, body=body), share) for share in (1.0, 0.5, 0.01)]
    features = encoder_features(garment, model.config.encoder_feature_count)
    first = np.asarray(session(encoder).run(["patch_first"], {"patch_features": features})[0])
    garments, places, patch, tile = [], [], 0, 0
    for feed in feeds:
        packed_garment = pack_garment(feed, first)
        garments.append(packed_garment)
        places.append(Place(patch, tile))
        patch, tile = patch + packed_garment.patch_count, tile + packed_garment.tile_count
    stored = {name: np.concatenate([item.stored[name] for item in garments]) for name in garments[0].stored}
    poses = parity_poses(BATCH_FRAMES, seed=3)
    betas = [np.zeros(body.shape_count), np.random.default_rng(0).normal(size=body.shape_count)]
    shape_of = [frame % 2 for frame in range(BATCH_FRAMES)]
    rows = [pack_body(body, betas[shape]).rows(poses[i : i + 1]) for i, shape in enumerate(shape_of)]
    bodies = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    items = [(i % len(garments), i) for i in range(BATCH_FRAMES)]
    bodies |= SkinShapes(body).feed(bodies["betas"])
    composition = compose_garments([(garments[g], places[g], frame) for g, frame in items])
    names = [spec.name for spec in drape_inputs(model)]
    code = {}
    if model.config.dynamic:
        drawn = np.random.default_rng(1).normal(size=(BATCH_FRAMES, model.config.body_code_size)).astype(np.float32)
        code["dynamic_code"] = drawn if "dynamic_code" in names else 0.0 * drawn
    draped = _run(packed, bodies | stored | composition.arrays | code).reshape(-1, 3)

    with torch.no_grad():
        embedding = EncoderGraph(model)({"patch_features": torch.from_numpy(features)}).numpy()
    worst = 0.0
    for place, (g, frame) in zip(composition.vertices, items, strict=True):
        feed = body_feed(body, poses[frame : frame + 1], np.zeros((1, 3)), betas[shape_of[frame]], skin=True)
        arrays = feed.arrays | feeds[g] | {"patch_embedding": embedding}
        arrays |= {name: value[frame : frame + 1] for name, value in code.items()}
        with torch.no_grad():
            expected = DrapeGraph(model)({name: torch.from_numpy(arrays[name]) for name in names})[0].numpy()
        worst = max(worst, float(np.linalg.norm(draped[place] - expected[0], axis=-1).max()))
    return worst


def _run(packed: Path, arrays: dict[str, np.ndarray]) -> np.ndarray:
    """The vertices of the graph, which takes its inputs among ``arrays``."""
    graph = session(packed)
    return np.asarray(graph.run(["vertices"], {item.name: arrays[item.name] for item in graph.get_inputs()})[0])


def _first_vertices(feed: dict[str, np.ndarray], share: float) -> dict[str, np.ndarray]:
    """The garment of the first ``share`` of the vertices."""
    count = max(1, int(share * len(feed["chart_patch"])))
    return {name: value[:count] if name.startswith(("chart", "skin")) else value for name, value in feed.items()}


Case = tuple[dict[str, np.ndarray], np.ndarray]  # inputs of a graph by name, and what numpy makes of them


def push_case(garment: Garment, poses: np.ndarray, clearance_m: float = CLEARANCE_M) -> Case:
    """Returns the inputs by name of the graph "push_out" for ``garment``, skinned in ``poses`` (F, 24, 3) [rad], and
    the vertices [m] (F, V, 3) as NumPy pushes them out."""
    drapes, skin = _skinned(garment, poses, clearance_m), body_skin(load_body())
    feed = pack_push(garment_feed(garment), garment.vertices[: garment.vertex_count], skin)
    expected = push_out(drapes.vertices, drapes.samples(), feed, np.float32(clearance_m))
    return PushTensors(**vars(drapes), feed=feed).flat(), expected


def layer_case(outer: Garment, inner: Garment, poses: np.ndarray, clearance_m: float = CLEARANCE_M) -> Case:
    """Returns the inputs by name of the graph "push_over" for ``outer`` over ``inner``, both skinned in ``poses``
    (F, 24, 3) [rad], and the vertices [m] (F, V, 3) of ``outer`` as NumPy pushes them out."""
    drapes, under = _skinned(outer, poses, clearance_m), _skinned(inner, poses, clearance_m).vertices
    rest = outer.vertices[: outer.vertex_count]
    feed = pack_layer(garment_feed(outer), rest, body_skin(load_body()), [inner_garment(inner)])
    expected = push_over(drapes.vertices, under, drapes.samples(), feed, np.float32(clearance_m))
    return LayerTensors(**vars(drapes), feed=feed, under=under).flat(), expected


@flushed()
def push_parity_error(folder: Path, garment: Garment) -> float:
    """Returns the largest distance [m] of a vertex between NumPy's push-out and that of the graphs in ``folder``, of
    ``garment`` alone and of ``garment`` worn over itself."""
    poses = parity_poses(3)
    cases = {"push_out": push_case(garment, poses), "push_over": layer_case(garment, garment, poses)}
    worst = 0.0
    for name, (arrays, expected) in cases.items():
        pushed = np.asarray(session(folder / f"{name}.onnx").run(["pushed"], arrays)[0])
        worst = max(worst, float(np.linalg.norm(pushed - expected, axis=-1).max()))
    return worst


def _skinned(garment: Garment, poses: np.ndarray, clearance_m: float) -> Drapes:
    body, count = load_body(), garment.vertex_count
    rotations, translations = body.bones(poses)
    rest = np.broadcast_to(garment.vertices[:count], (len(poses), count, 3)).astype(np.float64)
    vertices = skin_points(rest, garment.skin_weights(body)[:count].astype(np.float64), rotations, translations)
    drapes = Drapes(
        vertices=vertices,
        rotation=rotations,
        translation=translations,
        clearance=np.full(1, clearance_m),
        skin=body_skin(body).on_bones(body),
    )
    return drapes.each(lambda array: array.astype(np.float32) if array.dtype == np.float64 else array)
