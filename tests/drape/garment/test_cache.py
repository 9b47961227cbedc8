"""The garment cache: round trip, name, refusals of damaged files, atomic writing, inspection."""

from __future__ import annotations

import dataclasses
import io
import json

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.cloth import rest_state
from drape.errors import ArtifactError, Unavailable
from drape.files import packed
from drape.garment import cache
from drape.garment.cache import Garment, load_garment, save_garment
from tests.drape.garment.rest_garments import barrel_garment


@pytest.fixture
def stored(tmp_path):
    return save_garment(barrel_garment(), tmp_path / "garments")


def same_garment(a: Garment, b: Garment) -> None:
    for field in dataclasses.fields(Garment):
        have, want = getattr(a, field.name), getattr(b, field.name)
        if isinstance(want, np.ndarray):
            assert have.dtype == want.dtype
            assert_array_equal(have, want)
        else:
            assert have == want


def rewrite(path, *, header=None, without=(), **arrays):
    """Replaces entries of the file at ``path``."""
    with np.load(path) as data:
        entries = {key: data[key] for key in data.files if key not in without} | arrays
    if header is not None:
        entries["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    np.savez(path, **entries)


def header_of(path):
    with np.load(path) as data:
        return json.loads(bytes(data["header"]))


def test_garment_is_read_as_it_was_written(stored):
    same_garment(load_garment(stored), barrel_garment())


def test_a_file_of_numpys_own_packing_is_read_too(stored):
    rewrite(stored)
    same_garment(load_garment(stored), barrel_garment())


def test_fine_faces_that_are_the_faces_are_stored_once(tmp_path):
    garment = dataclasses.replace(barrel_garment(), fine_faces=barrel_garment().faces)
    path = save_garment(garment, tmp_path)
    with np.load(path) as data:
        assert "faces" in data.files and "fine_faces" not in data.files
    same_garment(load_garment(path), garment)


def with_rest(garment: Garment) -> Garment:
    state = rest_state.flat(garment.vertices, garment.fine_faces)
    arrays = {"rest_edges": state.edges, "rest_angle": state.hinge_angle, "rest_stiffening": 2.0 * state.stiffening}
    arrays = {name: array.astype(np.float32) for name, array in arrays.items()}
    return dataclasses.replace(garment, fabric={"name": "mine", "warp_n_per_m": 80.0}, **arrays)


def test_rest_state_and_fabric_are_read_as_they_were_written(tmp_path):
    garment = with_rest(barrel_garment())
    read = load_garment(save_garment(garment, tmp_path))
    same_garment(read, garment)
    state = read.rest_state()
    assert_array_equal(state.edges, garment.rest_edges)
    assert_array_equal(state.stiffening, 2.0)
    assert {state.edges.dtype, state.hinge_angle.dtype} == {np.dtype(np.float64)}


def test_a_garment_of_before_has_the_rest_state_of_its_mesh(stored):
    header = {key: value for key, value in header_of(stored).items() if key != "fabric"}
    rewrite(stored, header=header)
    read = load_garment(stored)
    assert (read.rest_edges, read.fabric) == (None, "jersey")
    expected = rest_state.flat(read.vertices, read.fine_faces)  # a tube has no crease
    assert_array_equal(read.rest_state().edges, expected.edges)
    assert_array_equal(read.rest_state().hinge_angle, 0.0)
    assert read.rest_state() is read.rest_state()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rest_edges": np.ones((3, 2, 2))}, "rest_edges: expected shape"),
        ({"rest_angle": np.zeros(5)}, r"rest_angle: expected shape \(\d+,\), got shape \(5,\)"),
        ({"rest_stiffening": None}, "rest_stiffening: expected shape .* got nothing"),
    ],
)
def test_a_rest_state_of_another_mesh_is_refused(change, message):
    with pytest.raises(ArtifactError, match=message):
        dataclasses.replace(with_rest(barrel_garment()), **change).rest_state()


def test_name_carries_garment_and_digest(stored):
    assert stored.name == f"barrel-{'d' * 16}.npz"


def test_writing_leaves_only_the_file_and_replaces_the_old_one(stored):
    changed = dataclasses.replace(barrel_garment(), manifest={"again": 1})
    assert save_garment(changed, stored.parent) == stored
    assert [path.name for path in stored.parent.iterdir()] == [stored.name]
    assert load_garment(stored).manifest == {"again": 1}


def test_crash_while_writing_leaves_the_old_file(stored, monkeypatch):
    def crash(*paths):
        raise OSError("power cut")

    monkeypatch.setattr(packed.os, "replace", crash)
    with pytest.raises(Unavailable, match="power cut"):
        save_garment(dataclasses.replace(barrel_garment(), manifest={"again": 1}), stored.parent)
    same_garment(load_garment(stored), barrel_garment())
    assert list(stored.parent.iterdir()) == [stored]


def test_file_holds_plain_arrays_only(stored):
    with np.load(stored, allow_pickle=False) as data:
        assert all(data[key].dtype.kind in "iuf" for key in data.files)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
def test_truncated_file_is_refused(stored, share):
    payload = stored.read_bytes()
    stored.write_bytes(payload[: int(share * len(payload))])
    with pytest.raises(ArtifactError, match="expected a garment npz"):
        load_garment(stored)


@pytest.mark.parametrize("place", [0.02, 0.3, 0.6, 0.9])
def test_damaged_file_is_refused(stored, place):
    payload = bytearray(stored.read_bytes())
    start = int(place * len(payload))
    payload[start : start + 400] = bytes(400)
    stored.write_bytes(payload)
    with pytest.raises(ArtifactError, match="garment cache barrel"):
        load_garment(stored)


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(ArtifactError, match="expected a garment npz"):
        load_garment(tmp_path / "nothing.npz")


@pytest.mark.parametrize("save", [np.save, lambda path, array: np.savez(path, x=array)])
def test_file_of_something_else_is_refused(tmp_path, save):
    path, stream = tmp_path / "other.npz", io.BytesIO()
    save(stream, np.zeros(3))
    path.write_bytes(stream.getvalue())
    with pytest.raises(ArtifactError, match="expected a garment npz"):
        load_garment(path)


@pytest.mark.parametrize("header", [[1, 2], "text", 3, None])
def test_header_that_is_no_object_is_refused(stored, header):
    rewrite(stored, without=("header",))
    with np.load(stored) as data:
        entries = {key: data[key] for key in data.files}
    np.savez(stored, header=np.frombuffer(json.dumps(header).encode(), dtype=np.uint8), **entries)
    with pytest.raises(ArtifactError, match="expected a garment npz"):
        load_garment(stored)


@pytest.mark.parametrize("version", [0, 2, None, "1"])
def test_another_format_is_refused(stored, version):
    rewrite(stored, header={**header_of(stored), "format_version": version})
    with pytest.raises(ArtifactError, match=f"format_version: expected {cache.FORMAT_VERSION}, got {version}"):
        load_garment(stored)


ARRAYS = [f.name for f in dataclasses.fields(Garment) if isinstance(getattr(barrel_garment(), f.name), np.ndarray)]


@pytest.mark.parametrize("field", ARRAYS)
def test_missing_array_is_refused(stored, field):
    rewrite(stored, without=(field,))
    with pytest.raises(ArtifactError, match=f"the fields of Garment.*{field}"):
        load_garment(stored)


@pytest.mark.parametrize("field", ["name", "digest", "body_digest", "vertex_count", "material_names"])
def test_missing_text_is_refused(stored, field):
    header = header_of(stored)
    del header[field]
    rewrite(stored, header=header)
    with pytest.raises(ArtifactError, match=f"the fields of Garment.*{field}"):
        load_garment(stored)


def test_foreign_array_is_refused(stored):
    rewrite(stored, surplus=np.zeros(2))
    with pytest.raises(ArtifactError, match="surplus"):
        load_garment(stored)


def test_heaviest_bone_has_the_largest_weight():
    garment = barrel_garment()
    heaviest = garment.heaviest_bone
    assert heaviest.dtype == np.int64
    rows = np.arange(garment.patch_count)
    assert_array_equal(garment.patch_weights[rows, heaviest], garment.patch_weights.max(axis=1))


def test_inspection_prints_every_array_and_the_manifest(stored, capsys):
    assert cache.main([str(stored)]) == 0
    printed = capsys.readouterr().out
    assert all(f"  {name} " in printed for name in ARRAYS)
    assert '"point_rmse_m"' in printed


def test_inspection_refuses_with_a_sentence(tmp_path, capsys):
    (tmp_path / "text.npz").write_text("hello")
    for name, word in (("absent.npz", "an existing file"), ("text.npz", "a garment npz")):
        assert cache.main([str(tmp_path / name)]) == 2
        assert word in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    for folder in (tmp_path / "file", tmp_path / "file" / "inside"):
        with pytest.raises(Unavailable, match="a folder that can be written"):
            save_garment(barrel_garment(), folder)
