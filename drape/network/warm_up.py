"""Compiles the network's kernels and stores them, so that no service waits for it."""

from __future__ import annotations

import numpy as np

from drape.artifacts import MODELS_DIR, load_manifest, read_parameters
from drape.body.assets import load_body
from drape.body.pose_support import read_pose_support
from drape.body.skeleton import JOINT_COUNT
from drape.garment.cache import GARMENTS_DIR, load_garment
from drape.graph.feeds import garment_feed
from drape.graph.packed import PART_SIZE
from drape.graph.packing import pack_body, pack_garment
from drape.graph.push_feed import SkinShapes
from drape.network.bodies import BodyFeed, moments, posed_body
from drape.network.drape import checked_jets
from drape.network.novelty import kept_poses, novelty
from drape.network.patch_rows import patch_rows
from drape.network.weights import weights_of


def warm_up(model: str = "onefit") -> None:
    """Drapes a shipped garment once with the shipped ``model``."""
    manifest, body = load_manifest(MODELS_DIR / model), load_body()
    assert manifest.weights is not None
    weights = weights_of(read_parameters(MODELS_DIR / model, manifest.weights), manifest.network["output_gain"])
    garment = load_garment(next(GARMENTS_DIR.glob("tank-*.npz")))
    first = np.zeros((garment.patch_count, len(weights.surroundings.bias)), np.float32)
    packed = pack_garment(garment_feed(garment, body=body), first)
    shape = pack_body(body)
    local = shape.rows(np.zeros((1, JOINT_COUNT, 3)))["joint_quaternion"][0]
    shapes = SkinShapes(body)
    skins = shapes.feed(shape.betas[None])
    skin = np.empty((PART_SIZE * len(skins["skin_bones"]), 8), np.float32)
    moments(body, np.zeros((1, JOINT_COUNT, 3)), np.zeros((1, 3)))
    parts = skins["skin_rows"][0], skins["skin_bones"], shapes.counts
    feed = BodyFeed(local[:JOINT_COUNT], shape.joint_rest, shape.betas, np.empty(0, np.float32), *parts)
    checked_jets(weights, patch_rows(packed, first), posed_body(weights, feed, skin), 1, packed.patch_count)
    novelty(kept_poses(read_pose_support(MODELS_DIR / model / "poses.npz")), np.zeros((1, JOINT_COUNT, 3)))
