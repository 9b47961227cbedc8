"""What the engine asks of a dynamic model's folder."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

from drape.artifacts import load_manifest
from drape.errors import ArtifactError
from service.graphs.engine import DYNAMIC, PACKED, Engine
from tests.fixtures.packed import MOVING
from tests.fixtures.tiny_model import STATE_SIZE, TINY, TINY_DYNAMIC


@pytest.fixture
def folder(tiny_folder: Path, tmp_path: Path) -> Path:
    """A copy of the dynamic model that a test may spoil."""
    return Path(shutil.copytree(tiny_folder / "models" / TINY_DYNAMIC, tmp_path / TINY_DYNAMIC))


def rewrite(folder: Path, **changes: object) -> None:
    manifest = dataclasses.replace(load_manifest(folder), **changes)
    (folder / "manifest.json").write_text(manifest.to_json())


def test_the_engine_knows_what_it_opened(folder: Path, tiny_folder: Path):
    engine = Engine(folder)
    assert (engine.dynamic, engine.state_size, engine.code_size) == (True, STATE_SIZE, MOVING.body_code_size)
    static = Engine(tiny_folder / "models" / TINY)
    assert (static.dynamic, static.state_size, static.code_size) == (False, 0, 0)


def test_a_dynamic_model_without_its_recurrent_graph_is_refused(folder: Path):
    graphs = load_manifest(folder).graphs
    rewrite(folder, graphs={key: spec for key, spec in graphs.items() if key != DYNAMIC})
    with pytest.raises(ArtifactError, match=f"graph '{DYNAMIC}'"):
        Engine(folder)


@pytest.mark.parametrize("changes", [{"dynamic": False}, {"state_size": STATE_SIZE + 1}])
def test_a_manifest_that_says_otherwise_than_its_graphs_is_refused(folder: Path, changes: dict):
    rewrite(folder, **changes)
    with pytest.raises(ArtifactError, match="dynamic: expected a packed graph with a dynamic_code"):
        Engine(folder)


def test_a_packed_graph_that_takes_no_code_is_refused(folder: Path):
    graphs = load_manifest(folder).graphs
    inputs = tuple(tensor for tensor in graphs[PACKED].inputs if tensor.name != "dynamic_code")
    rewrite(folder, graphs={**graphs, PACKED: dataclasses.replace(graphs[PACKED], inputs=inputs)})
    with pytest.raises(ArtifactError, match="dynamic: expected a packed graph with a dynamic_code"):
        Engine(folder)


def test_a_state_that_is_not_finite_is_refused(folder: Path):
    engine = Engine(folder)
    features = np.zeros((2, 24, 12), np.float32)
    features[1, 0, 9] = np.nan
    with pytest.raises(ArtifactError, match="next_state: expected finite numbers"):
        engine.advance(features, np.zeros((2, STATE_SIZE)), np.full(2, 0.03))
