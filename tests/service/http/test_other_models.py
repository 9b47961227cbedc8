"""Models that the engine does not compute: ONNX Runtime serves their readable graph as it is."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.body.model import BodyModel
from drape.cloth.fabric_table import fabric
from drape.garment.cache import Garment
from drape.garment.fabric_features import encoder_features
from drape.graph.feeds import body_feed, garment_feed, skinning_feed
from model_export.readable_graphs import DrapeGraph, EncoderGraph, drape_inputs
from service.settings import Settings
from tests.fixtures.packed import exported, exported_paper
from tests.fixtures.poses import random_motion
from tests.fixtures.serving import served, vertices_of
from tests.fixtures.tiny_model import ROUNDING_M
from training.onefit import OneFit

pytestmark = pytest.mark.slow
POSES, TRANS = random_motion(2)


def described_otherwise(folder: Path) -> tuple[OneFit, Path]:
    """A network whose manifest describes one that the engine does not cover, in ``folder``, and where it lies."""
    model, source, manifest = exported()
    copied = Path(shutil.copytree(source, folder / "odd"))
    odd = replace(manifest, name="odd", network=manifest.network | {"decoder_sizes": [20, 10]})
    (copied / "manifest.json").write_text(odd.to_json())
    return model, copied


def expected(model: OneFit, body: BodyModel, garment: Garment, **chosen: str) -> np.ndarray:
    """World vertices [m] (F, V, 3) by the network in torch."""
    made_of = fabric(chosen["fabric"]) if chosen else None
    feed = body_feed(body, POSES, TRANS, np.zeros(body.shape_count), skin=True)
    features = encoder_features(garment, model.config.encoder_feature_count, made_of)
    with torch.no_grad():
        arrays = feed.arrays | garment_feed(garment, body=body) | skinning_feed(garment, body)
        arrays["patch_embedding"] = EncoderGraph(model)({"patch_features": torch.from_numpy(features)}).numpy()
        tensors = {spec.name: torch.from_numpy(arrays[spec.name]) for spec in drape_inputs(model)}
        return DrapeGraph(model)(tensors)[0].numpy() + feed.root[:, None]


@pytest.mark.parametrize("kind", ["paper", "odd"])
def test_a_frame_of_a_model_of_another_kind(
    kind: str, make_settings: Callable[..., Settings], body: BodyModel, tube: Garment, tmp_path: Path
):
    model, folder = exported_paper() if kind == "paper" else described_otherwise(tmp_path)
    asked = {"garment": "tube", "poses": POSES.tolist(), "trans": TRANS.tolist(), "push_out": False}
    with served(make_settings(model=str(folder))) as url, httpx.Client(base_url=url) as api:
        got = vertices_of(api.post("/drape", json=asked, timeout=60.0))
        assert_allclose(got, expected(model, body, tube), rtol=0, atol=ROUNDING_M)
        pushed = vertices_of(api.post("/drape", json=asked | {"push_out": True}, timeout=60.0))
        assert np.isfinite(pushed).all() and np.abs(pushed - got).max() > 1e-4
        if kind == "paper":
            refused = api.post("/drape", json=asked | {"geometry": "jets"})
            assert refused.status_code == 400 and "geometry: expected vertices with model paper" in refused.text
        else:
            made = vertices_of(api.post("/drape", json=asked | {"fabric": "denim"}, timeout=60.0))
            assert_allclose(made, expected(model, body, tube, fabric="denim"), rtol=0, atol=ROUNDING_M)
