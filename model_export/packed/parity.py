"""The packed graph on onnxruntime against the readable graph in torch, in one mixed batch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from drape.arrays.subnormals import flushed
from drape.body.assets import load_body
from drape.garment.cache import Garment
from drape.garment.fabric_features import encoder_features
from drape.graph.feeds import body_feed, garment_feed
from drape.graph.packing import Place, compose, pack_body, pack_garment
from drape.graph.push_feed import SkinShapes
from model_export.graph import DrapeGraph, EncoderGraph, drape_inputs
from model_export.parity import hard_poses, session
from training.model import OneFit

FRAMES = 5


@flushed()
def packed_parity_error(model: OneFit, encoder: Path, packed: Path, garment: Garment) -> float:
    """Largest vertex distance [m] of one batch: hard poses of two body shapes, the garment in three sizes of itself."""
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
    stored = {name: np.concatenate([one.stored[name] for one in garments]) for name in garments[0].stored}
    poses = hard_poses(FRAMES, seed=3)
    betas = [np.zeros(body.shape_count), np.random.default_rng(0).normal(size=body.shape_count)]
    shape_of = [frame % 2 for frame in range(FRAMES)]
    rows = [pack_body(body, betas[shape]).rows(poses[i : i + 1]) for i, shape in enumerate(shape_of)]
    bodies = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    items = [(i % len(garments), i) for i in range(FRAMES)]
    bodies |= SkinShapes(body).feed(bodies["betas"])
    composition = compose([(garments[g], places[g], frame) for g, frame in items])
    names = [spec.name for spec in drape_inputs(model)]
    code = {}
    if model.config.dynamic:
        drawn = np.random.default_rng(1).normal(size=(FRAMES, model.config.body_code_size)).astype(np.float32)
        code["dynamic_code"] = drawn if "dynamic_code" in names else 0.0 * drawn
    got = _run(packed, bodies | stored | composition.arrays | code)

    with torch.no_grad():
        embedding = EncoderGraph(model)({"patch_features": torch.from_numpy(features)}).numpy()
    worst = 0.0
    for place, (g, frame) in zip(composition.vertices, items, strict=True):
        feed = body_feed(body, poses[frame : frame + 1], np.zeros((1, 3)), betas[shape_of[frame]], skin=True)
        arrays = feed.arrays | feeds[g] | {"patch_embedding": embedding}
        arrays |= {name: value[frame : frame + 1] for name, value in code.items()}
        with torch.no_grad():
            expected = DrapeGraph(model)({name: torch.from_numpy(arrays[name]) for name in names})[0].numpy()
        worst = max(worst, float(np.linalg.norm(got.reshape(-1, 3)[place] - expected[0], axis=-1).max()))
    return worst


def _run(packed: Path, arrays: dict[str, np.ndarray]) -> np.ndarray:
    """The vertices of the graph, which takes its inputs among ``arrays``."""
    graph = session(packed)
    return np.asarray(graph.run(["vertices"], {item.name: arrays[item.name] for item in graph.get_inputs()})[0])


def _first_vertices(feed: dict[str, np.ndarray], share: float) -> dict[str, np.ndarray]:
    """The garment of the first ``share`` of the vertices."""
    count = max(1, int(share * len(feed["chart_patch"])))
    return {name: value[:count] if name.startswith(("chart", "skin")) else value for name, value in feed.items()}
