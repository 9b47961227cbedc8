"""The model folder: manifest round trip, digests, refusals, and replacement in one step."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from pathlib import Path

import pytest

from drape import artifacts
from drape.artifacts import (
    DEFAULT_MODEL,
    MODELS_DIR,
    GraphSpec,
    Manifest,
    TensorSpec,
    WeightsSpec,
    file_digest,
    load_manifest,
    model_folder,
    publish_folder,
)
from drape.errors import ArtifactError, NotFound
from tests.fixtures.laws import each

CONTENTS = {"encoder.onnx": b"first graph", "drape.onnx": b"second graph", "weights.bin": b"tensors of both"}


def graph(file: str) -> GraphSpec:
    return GraphSpec(
        file=file,
        sha256=hashlib.sha256(CONTENTS[file]).hexdigest(),
        opset=20,
        inputs=(
            TensorSpec("poses", ("frame", 24, 3), "float32", "rad"),
            TensorSpec("chart_patch", ("vertex", 4), "int64"),
        ),
        outputs=(TensorSpec("vertices", ("frame", "vertex", 3), "float32", "m"),),
    )


@pytest.fixture
def manifest():
    return Manifest(
        name="first",
        graphs={"garment_encoder": graph("encoder.onnx"), "drape": graph("drape.onnx")},
        body="anny_default",
        body_digest="0" * 64,
        embedding_size=16,
        parity_error_m=1e-6,
        dynamic=True,
        state_size=8,
        training={"commit": "abc", "frames": 3},
        quality=[{"garment": "tank", "rmse_mm": 1.5}],
        weights=WeightsSpec("weights.bin", hashlib.sha256(CONTENTS["weights.bin"]).hexdigest()),
    )


@pytest.fixture
def folder(tmp_path, manifest):
    """A model folder whose files match its manifest."""
    folder = tmp_path / "first"
    folder.mkdir()
    for file, payload in CONTENTS.items():
        (folder / file).write_bytes(payload)
    (folder / "manifest.json").write_text(manifest.to_json())
    return folder


def test_a_manifest_from_before_there_was_dynamics_is_static(manifest):
    data = json.loads(manifest.to_json())
    del data["state_size"], data["dynamic"]
    read = Manifest.from_json(json.dumps(data), where="manifest.json")
    assert (read.dynamic, read.state_size) == (False, 0)


def test_a_folder_from_before_there_were_shared_weights_is_read(folder, manifest):
    data = json.loads(manifest.to_json())
    del data["weights"]
    (folder / "manifest.json").write_text(json.dumps(data))
    (folder / "weights.bin").unlink()
    assert load_manifest(folder) == dataclasses.replace(manifest, weights=None)


def test_manifest_with_defaults_is_read_as_it_was_written(manifest):
    plain = Manifest("first", {}, "anny_default", "0" * 64, 16, 0.0)
    assert Manifest.from_json(plain.to_json(), where="manifest.json") == plain
    assert plain.format_version == artifacts.FORMAT_VERSION


def test_unit_of_a_tensor_may_be_left_out():
    assert TensorSpec.from_json({"name": "x", "shape": ["n", 3], "dtype": "int64"}) == TensorSpec(
        "x", ("n", 3), "int64"
    )


def test_folder_is_read_as_it_was_written(folder, manifest):
    assert load_manifest(folder) == manifest


def test_digest_changes_with_any_file_and_with_nothing_else(manifest):
    digests = {manifest.digest}
    for key, spec in manifest.graphs.items():
        changed = {**manifest.graphs, key: dataclasses.replace(spec, sha256="f" * 64)}
        digests.add(dataclasses.replace(manifest, graphs=changed).digest)
    exchanged = dict(zip(manifest.graphs, reversed(manifest.graphs.values()), strict=True))
    digests.add(dataclasses.replace(manifest, graphs=exchanged).digest)
    digests.add(dataclasses.replace(manifest, weights=WeightsSpec("weights.bin", "f" * 64)).digest)
    digests.add(dataclasses.replace(manifest, weights=None).digest)
    assert len(digests) == 6
    reordered = dict(reversed(manifest.graphs.items()))
    assert dataclasses.replace(manifest, graphs=reordered, training={}, quality=[]).digest == manifest.digest


def test_file_digest_is_sha256(tmp_path):
    (tmp_path / "file").write_bytes(b"abc")
    assert file_digest(tmp_path / "file") == hashlib.sha256(b"abc").hexdigest()


def test_a_model_is_a_folder_or_a_shipped_name(folder, monkeypatch):
    assert model_folder(str(folder)) == folder
    monkeypatch.chdir(folder.parent)
    assert model_folder(folder.name).resolve() == folder.resolve()
    assert load_manifest(model_folder(DEFAULT_MODEL)) and model_folder("absent") == MODELS_DIR / "absent"


def test_missing_model_is_not_found_and_the_others_are_named(folder):
    with pytest.raises(NotFound, match=r"one of \['first'\].*got second"):
        load_manifest(folder.parent / "second")


def text_of(folder) -> Path:
    return folder / "manifest.json"


def of_version(version):
    return lambda folder: text_of(folder).write_text(
        json.dumps({**json.loads(text_of(folder).read_text()), "format_version": version})
    )


FIELDS = {"encoder.onnx": "garment_encoder", "drape.onnx": "drape", "weights.bin": "weights"}
NO_MANIFEST = r"first/manifest\.json: expected a model manifest"
DAMAGE = {
    **{f"no {f}": (lambda d, f=f: (d / f).unlink(), f"first {FIELDS[f]}: expected {f}, got no such") for f in CONTENTS},
    **{f"other {f}": (lambda d, f=f: (d / f).write_bytes(b"another"), f"first/{f} sha256") for f in CONTENTS},
    **{f"version {v}": (of_version(v), f"format_version: expected 1, got {v}") for v in (0, 2, None, "1")},
    **{
        f"text {payload!r}": (lambda d, payload=payload: text_of(d).write_bytes(payload), NO_MANIFEST)
        for payload in (b"", b"{", b"[1, 2]", b"3", b"\xff\xfe\x00")
    },
}


@each(damage=DAMAGE)
def test_a_damaged_folder_is_refused_by_what_is_wrong(folder, damage):
    spoil, message = damage
    spoil(folder)
    with pytest.raises(ArtifactError, match=message):
        load_manifest(folder)


def change(data: dict, *path: str, remove: bool = False) -> dict:
    """``data`` with the entry at ``path`` removed, or a number there."""
    copy = json.loads(json.dumps(data))
    inner = copy
    for key in path[:-1]:
        inner = inner[key]
    inner.pop(path[-1], None)
    if not remove:
        inner[path[-1]] = 3
    return copy


@pytest.mark.parametrize(
    ("path", "remove"),
    [
        (("graphs",), True),
        (("graphs",), False),
        (("graphs", "drape"), False),
        (("graphs", "drape", "sha256"), True),
        (("graphs", "drape", "inputs"), False),
        (("name",), True),
        (("embedding_size",), True),
        (("weights",), False),
        (("weights", "file"), True),
        (("weights", "sha256"), True),
        (("unknown",), False),
    ],
)
def test_manifest_with_missing_or_foreign_entries_is_refused(manifest, path, remove):
    data = json.loads(manifest.to_json())
    with pytest.raises(ArtifactError, match="a model manifest"):
        Manifest.from_json(json.dumps(change(data, *path, remove=remove)), where="manifest.json")


def staged(tmp_path, content: str):
    folder = tmp_path / "staged"
    folder.mkdir()
    (folder / f"{content}.txt").write_text(content)
    return folder


def contents(folder) -> dict[str, list[str]]:
    return {path.name: sorted(file.name for file in path.iterdir()) for path in folder.iterdir()}


def test_publishing_replaces_the_folder_and_leaves_nothing_behind(tmp_path):
    target = tmp_path / "models" / "first"
    for content in ("old", "new"):
        publish_folder(staged(tmp_path, content), target)
        assert contents(target.parent) == {"first": [f"{content}.txt"]}
        assert not (tmp_path / "staged").exists()


@pytest.mark.parametrize("failing_call", [1, 2])
def test_crash_while_publishing_loses_neither_folder(tmp_path, monkeypatch, failing_call):
    target, calls, replace = tmp_path / "models" / "first", [], os.replace
    publish_folder(staged(tmp_path, "old"), target)

    def crash(*paths):
        calls.append(paths)
        if len(calls) == failing_call:
            raise OSError("power cut")
        replace(*paths)

    folder = staged(tmp_path, "new")
    with monkeypatch.context() as patch:
        patch.setattr(artifacts.os, "replace", crash)
        with pytest.raises(OSError, match="power cut"):
            publish_folder(folder, target)
    assert list(contents(target.parent).values()) == [["old.txt"]]
    assert contents(tmp_path)["staged"] == ["new.txt"]
    publish_folder(folder, target)
    assert contents(target.parent) == {"first": ["new.txt"]}
