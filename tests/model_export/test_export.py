"""Export: symbolic axes, parity, atomic folders, and refusal of a graph that differs."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import onnx
import pytest
import torch
from numpy.testing import assert_allclose

from drape.artifacts import load_manifest
from drape.body.assets import load_body
from drape.errors import ArtifactError
from drape.garment.cache import GARMENTS_DIR
from drape.geometry import jets
from drape.graph.feeds import body_feed, garment_feed, skinning_feed
from model_export import __main__ as command
from model_export import export as exporting
from model_export.onnx_file import _check_symbolic
from model_export.parity import parity_poses, session
from model_export.readable_graphs import DrapeGraph, drape_inputs
from tests.fixtures import packed
from tests.fixtures.garments import shipped
from tests.fixtures.networks import TINY
from tests.fixtures.rounding import FIT_ROUNDING
from training import checkpoint
from training.config import TrainConfig, as_published
from training.onefit import OneFit

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def garment():
    return shipped("tank")


def lively() -> OneFit:
    """A small network of the published form."""
    torch.manual_seed(0)
    model = OneFit(as_published(TINY)).eval()
    for head in model.decoder.heads.values():
        torch.nn.init.normal_(list(head.parameters())[-2], std=0.3)
    return model


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    """``lively``, the folder that the command makes of its checkpoint, and the manifest that the export returned."""
    model, folder = lively(), tmp_path_factory.mktemp("models")
    state = {"model": model.state_dict(), "step": 5, "elapsed_s": 60.0}
    checkpoint.save(folder / "c.pt", state, TrainConfig(model=model.config))
    (tank,) = GARMENTS_DIR.glob("tank-*.npz")
    returned = []

    def export(*arguments, **named):
        returned.append(exporting.export(*arguments, **named))
        return returned[-1]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(command, "export", export)
        words = [str(folder / "c.pt"), str(folder / "small"), "--garment", str(tank)]
        patched.setattr("sys.argv", ["model_export", *words])
        assert command.main() == 0
    return model, folder / "small", returned[0]


@pytest.fixture
def stored():
    """A network of our own form, its folder and its manifest: exported once and kept."""
    return packed.exported()


@pytest.fixture(params=["vector", pytest.param("paper", marks=pytest.mark.long)])
def exported(request):
    return packed.exported() if request.param == "vector" else request.getfixturevalue("published")


def test_every_named_axis_is_symbolic(exported):
    _, folder, manifest = exported
    for graph in manifest.graphs.values():
        proto = onnx.load(str(folder / graph.file))
        for specs, values in ((graph.inputs, proto.graph.input), (graph.outputs, proto.graph.output)):
            for spec, value in zip(specs, values, strict=True):
                for want, axis in zip(spec.shape, value.type.tensor_type.shape.dim, strict=True):
                    assert axis.HasField("dim_param") == isinstance(want, str), f"{spec.name} {spec.shape}"


def test_manifest_reads_back_and_holds_the_parity(exported):
    _, folder, manifest = exported
    assert load_manifest(folder) == manifest
    assert 0.0 < manifest.parity_error_m < 1e-5


@pytest.mark.parametrize(("frames", "vertices", "patches"), [(1, 1, 1), (4, 60, 100), (2, 3337, 100)])
def test_any_number_of_frames_vertices_and_patches_runs(exported, garment, frames, vertices, patches):
    model, folder, _ = exported
    feed = body_feed(load_body(), parity_poses(frames), np.zeros((frames, 3)), skin=True)
    arrays = feed.arrays | garment_feed(garment, body=load_body()) | skinning_feed(garment, load_body())
    size = model.config.embedding_size
    arrays["patch_embedding"] = np.random.default_rng(0).normal(size=(patches, size)).astype(np.float32)
    for name, value in arrays.items():
        if name.startswith("chart") or name == "skin_weights":
            arrays[name] = value[:vertices]
        elif name.startswith("patch"):
            arrays[name] = value[:patches]
    for name in ("chart_patch", "anchor_patch"):
        arrays[name] = np.minimum(arrays[name], patches - 1)
    names = [spec.name for spec in drape_inputs(model)]
    got = session(folder / "drape.onnx").run(None, {name: arrays[name] for name in names})
    with torch.no_grad():
        expected = DrapeGraph(model)({name: torch.from_numpy(arrays[name]) for name in names})
    for have, want in zip((np.asarray(array) for array in got), expected, strict=True):
        assert have.shape == tuple(want.shape)
        of_jets = have.shape[-1] in (jets.JET_COUNT, jets.FULL_COUNT)
        assert_allclose(have, want.numpy(), rtol=1e-4, atol=FIT_ROUNDING if of_jets else 1e-5)


def test_a_frame_is_the_same_alone_and_in_a_batch(exported, garment):
    model, folder, _ = exported
    feed = body_feed(load_body(), parity_poses(5), np.zeros((5, 3)), skin=True).arrays
    constants = (
        garment_feed(garment, body=load_body())
        | skinning_feed(garment, load_body())
        | {"patch_embedding": np.ones((garment.patch_count, model.config.embedding_size), dtype=np.float32)}
    )
    names = [spec.name for spec in drape_inputs(model)]
    run = session(folder / "drape.onnx")
    together = np.asarray(run.run(["vertices"], {n: (feed | constants)[n] for n in names})[0])
    for frame in range(5):
        alone = {key: value[frame : frame + 1] for key, value in feed.items()} | constants
        got = np.asarray(run.run(["vertices"], {n: alone[n] for n in names})[0])
        assert_allclose(got[0], together[frame], rtol=0, atol=1e-6)


def test_a_graph_that_differs_is_refused_and_the_old_model_stays(stored, garment, tmp_path, monkeypatch):
    model, folder, manifest = stored
    shutil.copytree(folder, tmp_path / "m")
    before = (tmp_path / "m" / "manifest.json").read_text()

    def written(model, staged):
        shutil.copytree(folder, staged, dirs_exist_ok=True)
        return manifest.graphs

    # As they were traced already, with shared weights.
    monkeypatch.setattr(exporting, "write_graphs", written)
    monkeypatch.setattr(exporting, "share_weights", lambda staged, graphs, parameters: (graphs, manifest.weights))
    exporting.export(model, tmp_path / "same", garment=garment, training={})
    other = OneFit(model.config).eval()
    other.load_state_dict(model.state_dict())
    with torch.no_grad():
        for head in other.decoder.heads.values():
            list(head.parameters())[-1].add_(0.1)
    with pytest.raises(ArtifactError, match="parity"):
        exporting.export(other, tmp_path / "m", garment=garment, training={})
    assert (tmp_path / "m" / "manifest.json").read_text() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m", "same"]


def test_a_baked_in_axis_is_refused(stored):
    _, folder, manifest = stored
    proto = onnx.load(str(folder / "drape.onnx"))
    proto.graph.input[0].type.tensor_type.shape.dim[0].dim_value = 3
    graph = manifest.graphs["drape"]
    with pytest.raises(ArtifactError, match="body_features"):
        _check_symbolic(proto, graph.inputs, graph.outputs, "drape.onnx")


def test_quality_is_written_into_a_standing_folder(stored, tmp_path, monkeypatch):
    _, folder, manifest = stored
    shutil.copytree(folder, tmp_path / "m")
    (tmp_path / "q.json").write_text(json.dumps({"rows": [{"garment": "tank", "gain": 0.5}]}))
    monkeypatch.setattr("sys.argv", ["model_export", "--quality", str(tmp_path / "q.json"), str(tmp_path / "m")])
    assert command.main() == 0
    assert load_manifest(tmp_path / "m") == replace(manifest, quality=[{"garment": "tank", "gain": 0.5}])
    assert sorted(p.name for p in (tmp_path / "m").iterdir()) == sorted(p.name for p in folder.iterdir())


@pytest.mark.long
def test_a_checkpoint_exports_through_the_command(published, tmp_path, monkeypatch):
    _, folder, manifest = published
    assert manifest.training["frames"] == 5 * TrainConfig().batch_size and manifest.training["garments"]
    assert {p.name for p in folder.iterdir()} >= {"manifest.json", *(graph.file for graph in manifest.graphs.values())}
    monkeypatch.setattr("sys.argv", ["model_export", str(tmp_path / "none.pt"), str(tmp_path / "out2")])
    assert command.main() == 2
    assert not (tmp_path / "out2").exists()
