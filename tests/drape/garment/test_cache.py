"""The garment cache: round trip, name, refusals of damaged files, atomic writing, inspection."""

from __future__ import annotations

import dataclasses
import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth import rest_state
from drape.errors import ArtifactError, Unavailable
from drape.files import atomic
from drape.garment import cache
from drape.garment.cache import Garment, load_garment, save_garment
from tests.drape.garment.rest_garments import barrel_garment
from tests.fixtures.laws import each


@pytest.fixture
def stored(tmp_path):
    return save_garment(barrel_garment(), tmp_path / "garments")


def same_garment(a: Garment, b: Garment) -> None:
    for field in dataclasses.fields(Garment):
        have, want = getattr(a, field.name), getattr(b, field.name)
        if field.name == "chart_residual":  # is left out and found again
            assert_allclose(have, want, rtol=0.0, atol=cache.SAME_M)
        elif isinstance(want, np.ndarray):
            assert have.dtype == want.dtype
            assert_array_equal(have, want)
        else:
            assert have == want


def rewrite(path, *, header=None, header_bytes=None, without=(), **arrays):
    """Replaces entries of the file at ``path``."""
    with np.load(path) as data:
        entries = {key: data[key] for key in data.files if key not in without} | arrays
    if header is not None or header_bytes is not None:
        entries["header"] = np.frombuffer(header_bytes or json.dumps(header).encode(), dtype=np.uint8)
    np.savez(path, **entries)


def header_of(path):
    with np.load(path) as data:
        return json.loads(bytes(data["header"]))


def test_garment_is_read_as_it_was_written_also_from_numpys_own_packing(stored):
    same_garment(load_garment(stored), barrel_garment())
    rewrite(stored)
    same_garment(load_garment(stored), barrel_garment())


def test_what_the_rest_tells_is_not_stored(stored):
    with np.load(stored) as data:
        assert not {"chart_residual", "skin_weights", "shapedirs"} & set(data.files)
    content = stored.read_bytes()
    assert save_garment(load_garment(stored), stored.parent).read_bytes() == content


def test_a_residual_of_another_form_is_kept(tmp_path):
    garment = dataclasses.replace(barrel_garment(), chart_residual=barrel_garment().chart_residual + np.float32(0.01))
    read = load_garment(save_garment(garment, tmp_path))
    assert_array_equal(read.chart_residual, garment.chart_residual)


def test_a_garment_of_the_former_version_is_read(stored):
    """It had what body and charts tell: skin weights, what shapes move, residuals."""
    count, residual = len(barrel_garment().vertices), barrel_garment().chart_residual
    once = {"skin_weights": np.zeros((count, 24)), "shapedirs": np.zeros((count, 3, 10)), "chart_residual": residual}
    rewrite(stored, header=header_of(stored) | {"format_version": 1}, **once)
    read = load_garment(stored)
    assert_array_equal(read.chart_residual, residual)
    same_garment(read, barrel_garment())
    assert header_of(save_garment(read, stored.parent))["format_version"] == 2


def test_fine_faces_that_are_the_faces_are_stored_once(tmp_path):
    garment = dataclasses.replace(barrel_garment(), fine_faces=barrel_garment().faces)
    path = save_garment(garment, tmp_path)
    with np.load(path) as data:
        assert "faces" in data.files and "fine_faces" not in data.files
    same_garment(load_garment(path), garment)


def test_faces_that_uv_tell_are_not_stored(tmp_path):
    garment = barrel_garment()
    uv = np.random.default_rng(0).random((garment.vertex_count + 1, 2)).astype(np.float32)
    seam = garment.faces.copy()
    seam[0, 0] = garment.vertex_count  # a vertex with two places in uv
    together = np.zeros_like(seam)  # all vertices have one place: it tells none of them
    for uv_faces, stored_as in ((seam, "uv_vertex"), (together, "faces")):
        textured = dataclasses.replace(garment, uv=uv, uv_faces=uv_faces)
        path = save_garment(textured, tmp_path)
        with np.load(path) as data:
            assert {"faces", "uv_vertex"} & set(data.files) == {stored_as}
        same_garment(load_garment(path), textured)
    rewrite(path, without=("faces",), uv_vertex=np.zeros(0, dtype=np.int32))
    with pytest.raises(ArtifactError, match="the fields of Garment"):
        load_garment(path)


def with_rest(garment: Garment) -> Garment:
    state = rest_state.flat_rest(garment.vertices, garment.fine_faces)
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
    expected = rest_state.flat_rest(read.vertices, read.fine_faces)  # a tube has no crease
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


def test_writing_leaves_only_the_file_and_replaces_the_old_one(stored):
    changed = dataclasses.replace(barrel_garment(), manifest={"again": 1})
    assert save_garment(changed, stored.parent) == stored
    assert [path.name for path in stored.parent.iterdir()] == [f"barrel-{'d' * 16}.npz"]
    assert load_garment(stored).manifest == {"again": 1}


def test_crash_while_writing_leaves_the_old_file(stored, monkeypatch):
    def crash(*paths):
        raise OSError("power cut")

    monkeypatch.setattr(atomic.os, "replace", crash)
    with pytest.raises(Unavailable, match="power cut"):
        save_garment(dataclasses.replace(barrel_garment(), manifest={"again": 1}), stored.parent)
    same_garment(load_garment(stored), barrel_garment())
    assert list(stored.parent.iterdir()) == [stored]


def test_file_holds_plain_arrays_only(stored):
    with np.load(stored, allow_pickle=False) as data:
        assert all(data[key].dtype.kind in "iuf" for key in data.files)


ARRAYS = [f.name for f in dataclasses.fields(Garment) if isinstance(getattr(barrel_garment(), f.name), np.ndarray)]
TEXTS = ("name", "digest", "body_digest", "vertex_count", "material_names")


def cut_to(share):
    """Damage that leaves this share of a file's beginning."""
    return lambda path: path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])


def blanked(place):
    """Damage that blanks 400 bytes from this share of a file on."""

    def spoil(path):
        payload = bytearray(path.read_bytes())
        start = int(place * len(payload))
        payload[start : start + 400] = bytes(400)
        path.write_bytes(payload)

    return spoil


def replaced_by(save):
    """Damage that writes another file of numpy's in a garment's place."""

    def spoil(path):
        with path.open("wb") as file:
            save(file, np.zeros(3))

    return spoil


def without_text(field):
    """Damage that takes one entry out of the header."""
    return lambda path: rewrite(path, header={key: value for key, value in header_of(path).items() if key != field})


def of_version(version):
    """Damage that says another format in the header."""
    return lambda path: rewrite(path, header={**header_of(path), "format_version": version})


NO_GARMENT, FIELDS = "expected a garment npz", "the fields of Garment.*"
DAMAGE = {
    "no file": (Path.unlink, NO_GARMENT),
    "an array": (replaced_by(np.save), NO_GARMENT),
    "other arrays": (replaced_by(lambda file, array: np.savez(file, x=array)), NO_GARMENT),
    "a foreign array": (lambda path: rewrite(path, surplus=np.zeros(2)), "surplus"),
    **{f"cut to {share}": (cut_to(share), NO_GARMENT) for share in (0.0, 0.01, 0.5, 0.99)},
    **{f"blank at {place}": (blanked(place), "garment cache barrel") for place in (0.02, 0.3, 0.6, 0.9)},
    **{f"header {text}": (partial(rewrite, header=text), NO_GARMENT) for text in ([1, 2], "text", 3)},
    "no header": (partial(rewrite, header_bytes=b"null"), NO_GARMENT),
    **{f"version {v}": (of_version(v), f"format_version: expected one of 1, 2, got {v}") for v in (0, 3, None, "1")},
    **{f"no {name}": (partial(rewrite, without=(name,)), FIELDS + name) for name in ARRAYS if name != "chart_residual"},
    **{f"no {name}": (without_text(name), FIELDS + name) for name in TEXTS},
}


@each(damage=DAMAGE)
def test_a_damaged_file_is_refused_by_what_it_lacks(stored, damage):
    spoil, message = damage
    spoil(stored)
    with pytest.raises(ArtifactError, match=message):
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
