"""Body files: round trips, licensed layouts, hostile and damaged files, and the shipped body's figures."""

from __future__ import annotations

import io
import json
import os
import pickle
import zipfile
import zlib

import numpy as np
import pytest
import scipy.sparse
from numpy.testing import assert_allclose, assert_array_equal

from drape.body import assets
from drape.body.assets import body_from_arrays, list_bodies, load_body, save_body
from drape.body.skeleton import JOINT_COUNT, PARENTS
from drape.errors import ArtifactError, BodyError, NotFound
from tests.drape.body.body_files import pickled_with_chumpy, python_two_pickle, smpl_arrays
from tests.fixtures.laws import each

FLOAT32 = 1e-6
ASSET_LIMIT_BYTES = 8_000_000
SAVED = ("v_template", "shapedirs", "J_regressor", "weights", "f")


@pytest.fixture
def arrays(rng):
    return smpl_arrays(rng)


@pytest.fixture
def npz(tmp_path, arrays):
    """A body written by save_body, with its record."""
    save_body(tmp_path / "figure", **{key: arrays[key] for key in SAVED}, about={"licence": "CC0"})
    return tmp_path / "figure.npz"


def pickle_file(folder, payload):
    """A body in a pickle, as SMPL's other licensed files come."""
    (folder / "smpl.pkl").write_bytes(payload)
    return folder / "smpl.pkl"


def bare_npz(path, arrays):
    """A body without a record, as a licensed SMPL file comes."""
    dense = {key: value.toarray() if scipy.sparse.issparse(value) else value for key, value in arrays.items()}
    np.savez_compressed(path, **dense)
    return path


def same_body(body, arrays, *, atol=0.0):
    assert_allclose(body.v_template, arrays["v_template"], rtol=0.0, atol=atol)
    assert_allclose(body.shapedirs, arrays["shapedirs"], rtol=0.0, atol=atol)
    assert_allclose(body.regressor.toarray(), arrays["J_regressor"].toarray(), rtol=0.0, atol=atol)
    assert_allclose(body.weights, arrays["weights"], rtol=0.0, atol=max(atol, 1e-15))
    assert_array_equal(body.faces, arrays["f"])


def test_saved_body_loads_as_it_was(npz, arrays):
    body = load_body(npz)
    same_body(body, arrays, atol=FLOAT32)
    assert body.name == "figure"
    assert body.posedirs is None


def test_record_carries_what_is_said_about_the_body_and_the_hash_that_names_it(npz):
    record = json.loads(npz.with_suffix(".json").read_text())
    assert record == {"licence": "CC0", "sha256": load_body(npz).digest}
    assert list_bodies(npz.parent) == ["figure"]


def test_saving_leaves_only_the_two_files(npz, arrays):
    save_body(npz.with_suffix(""), **{key: arrays[key] for key in SAVED}, about={})
    assert sorted(path.name for path in npz.parent.iterdir()) == ["figure.json", "figure.npz"]


def test_weights_are_normalised_on_loading(npz):
    assert_allclose(load_body(npz).weights.sum(axis=1), 1.0, rtol=0.0, atol=1e-15)


def test_body_that_does_not_match_its_hash_is_refused(npz):
    npz.write_bytes(npz.read_bytes() + b"\0")
    with pytest.raises(ArtifactError, match="sha256"):
        load_body(npz)


@pytest.mark.parametrize("text", ["{", "[]", "{}", "3"])
def test_damaged_record_is_refused(npz, text):
    npz.with_suffix(".json").write_text(text)
    with pytest.raises(ArtifactError, match="sha256"):
        load_body(npz)


@pytest.mark.parametrize("source", ["nobody", "nobody.npz", "nobody.pkl", "a/folder"])
def test_unknown_body_is_not_found_and_the_known_ones_are_named(source):
    with pytest.raises(NotFound, match="anny_default"):
        load_body(source)


def test_licensed_npz_loads(tmp_path, rng):
    arrays = smpl_arrays(rng, posedirs=True)
    body = load_body(bare_npz(tmp_path / "smpl.npz", arrays))
    same_body(body, arrays)
    assert_array_equal(body.posedirs, arrays["posedirs"])


@pytest.mark.parametrize("shape_count", [0, 3, 300])
def test_at_most_ten_shapes_are_kept(arrays, shape_count, rng):
    arrays["shapedirs"] = rng.normal(size=(len(arrays["v_template"]), 3, shape_count))
    body = body_from_arrays(arrays, name="figure", digest="")
    assert_array_equal(body.shapedirs, arrays["shapedirs"][..., :10])


def test_licensed_pickle_loads(tmp_path, rng):
    arrays = smpl_arrays(rng, posedirs=True)
    extras = {"bs_style": "lbs", "J": np.zeros((JOINT_COUNT, 3)), "weights_prior": arrays["J_regressor"]}
    body = load_body(pickle_file(tmp_path, pickled_with_chumpy({**arrays, **extras}, "shapedirs", "posedirs")))
    same_body(body, arrays)
    assert_array_equal(body.posedirs, arrays["posedirs"])


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_pickle_of_every_protocol_loads(tmp_path, arrays, protocol):
    payload = pickled_with_chumpy(arrays, "shapedirs", dump=lambda value: pickle.dumps(value, protocol))
    same_body(load_body(pickle_file(tmp_path, payload)), arrays)


class Hostile:
    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_hostile_pickle_is_refused_and_not_run(tmp_path, arrays, protocol):
    marker = tmp_path / "run"
    payload = pickle.dumps({**arrays, "bs_style": Hostile(os.system, f"touch '{marker}'")}, protocol)
    with pytest.raises(BodyError, match=r"asks for (posix|nt|os)"):
        load_body(pickle_file(tmp_path, payload))
    assert not marker.exists()


def beyond_itself(arrays):
    arrays["J_regressor"].indices[0] = 10**6
    return python_two_pickle(arrays)


REACHES_OUT = (
    b"cbuiltins\neval\n(V1+1\ntR.",
    b"\x80\x02c__builtin__\neval\nX\x03\x00\x00\x001+1\x85R.",
    b"cnumpy\nload\n(V/etc/hostname\ntR.",
    b"c_codecs\nencode\n(Vabc\nVzip\ntR.",
    b"\x80\x04\x8c\x0cscipy.sparse\x8c\x0dsave_npz.path\x93.",
)
NO_BODY = {
    **{f"reach {n}": (lambda arrays, payload=payload: payload, "asks for") for n, payload in enumerate(REACHES_OUT)},
    "a list": (lambda arrays: pickle.dumps([1, 2]), "got list"),
    "a sparse matrix that points outside itself": (beyond_itself, "J_regressor"),
    "chumpy without an array": (
        lambda arrays: pickled_with_chumpy({**arrays, "shapedirs": None}, "shapedirs"),
        "no shapedirs",
    ),
}


@each(case=NO_BODY)
def test_pickle_of_anything_beyond_the_arrays_of_a_body_is_refused(tmp_path, arrays, case):
    payload, message = case
    path = pickle_file(tmp_path, payload(arrays))
    with pytest.raises(BodyError, match=message):
        load_body(path)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.7, 0.99])
@pytest.mark.parametrize("kind", ["npz", "pkl"])
def test_truncated_file_is_refused(tmp_path, arrays, kind, share):
    if kind == "pkl":
        path = pickle_file(tmp_path, python_two_pickle(arrays))
    else:
        path = bare_npz(tmp_path / "smpl.npz", arrays)
    payload = path.read_bytes()
    path.write_bytes(payload[: int(share * len(payload))])
    with pytest.raises(BodyError, match=path.name):
        load_body(path)


def test_npz_with_damaged_contents_is_refused(tmp_path, arrays):
    path = bare_npz(tmp_path / "smpl.npz", arrays)
    payload = bytearray(path.read_bytes())
    payload[200:400] = bytes(200)
    path.write_bytes(payload)
    with pytest.raises(BodyError, match=r"smpl\.npz"):
        load_body(path)


def test_npz_with_a_wrong_checksum_is_refused(tmp_path):
    path = tmp_path / "smpl.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for key in assets.REQUIRED:
            archive.writestr(f"{key}.npy", bytes(300))
    path.write_bytes(path.read_bytes().replace(zlib.crc32(bytes(300)).to_bytes(4, "little"), b"\1\2\3\4"))
    with pytest.raises(BodyError, match=r"smpl\.npz"):
        load_body(path)


@pytest.mark.parametrize("content", ["object array", "bare npy"])
def test_npz_of_something_else_is_refused(tmp_path, content):
    path, stream = tmp_path / "smpl.npz", io.BytesIO()
    if content == "bare npy":
        np.save(stream, np.zeros(3))
    else:
        np.savez(stream, v_template=np.array([{}], dtype=object))
    path.write_bytes(stream.getvalue())
    with pytest.raises(BodyError, match="plain arrays"):
        load_body(path)


@pytest.mark.parametrize("key", assets.REQUIRED)
def test_missing_array_is_named(tmp_path, arrays, key):
    del arrays[key]
    with pytest.raises(BodyError, match=f"got no {key}"):
        load_body(bare_npz(tmp_path / "smpl.npz", arrays))


MISSHAPEN = {
    "flat v_template": ("v_template", np.zeros(180)),
    "v_template of pairs": ("v_template", np.zeros((60, 2))),
    "no vertices": ("v_template", np.zeros((0, 3))),
    "text": ("v_template", np.array([["a", "b", "c"]] * 60)),
    "shapedirs of others": ("shapedirs", np.zeros((59, 3, 10))),
    "flat shapedirs": ("shapedirs", np.zeros((180, 10))),
    "scalar shapedirs": ("shapedirs", np.zeros(())),
    "weights of 52 joints": ("weights", np.full((60, 52), 1 / 52)),
    "regressor of 52 joints": ("J_regressor", np.zeros((52, 60))),
    "flat regressor": ("J_regressor", np.zeros(60)),
    "deep regressor": ("J_regressor", np.zeros((2, 24, 60))),
    "faces of quads": ("f", np.zeros((10, 4), dtype=np.int32)),
    "flat tree": ("kintree_table", np.zeros(24, dtype=np.int32)),
    "tree of 52 joints": ("kintree_table", np.zeros((2, 52), dtype=np.int32)),
    "posedirs of SMPL-X": ("posedirs", np.zeros((60, 3, 486))),
    "posedirs as smplx keeps them": ("posedirs", np.zeros((207, 180))),
}


@pytest.mark.parametrize("case", MISSHAPEN)
def test_misshapen_array_is_named(tmp_path, arrays, case):
    key, value = MISSHAPEN[case]
    arrays[key] = value
    with pytest.raises(BodyError, match=f"body smpl {key}"):
        load_body(bare_npz(tmp_path / "smpl.npz", arrays))


@pytest.mark.parametrize("key", ["v_template", "shapedirs", "weights", "J_regressor", "posedirs"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused(rng, key, bad):
    arrays = smpl_arrays(rng, posedirs=True)
    (arrays[key].data if key == "J_regressor" else arrays[key]).flat[5] = bad
    with pytest.raises(BodyError, match=f"{key}: expected finite"):
        body_from_arrays(arrays, name="figure", digest="")


@pytest.mark.parametrize("index", [-1, 60])
def test_faces_beyond_the_vertices_are_refused(arrays, index):
    arrays["f"] = arrays["f"].astype(np.int64)
    arrays["f"][3, 1] = index
    with pytest.raises(BodyError, match=r"indices in \[0, 60\)"):
        body_from_arrays(arrays, name="figure", digest="")


def test_another_tree_is_refused(arrays):
    arrays["kintree_table"][0, 5] = 0
    with pytest.raises(BodyError, match="SMPL's 24-joint tree"):
        body_from_arrays(arrays, name="figure", digest="")


@pytest.mark.parametrize("root", [-1, 2**32 - 1])
def test_both_ways_to_write_the_roots_parent_are_read(arrays, root):
    arrays["kintree_table"] = np.array([[root, *PARENTS[1:]], range(JOINT_COUNT)], dtype=np.int64)
    assert body_from_arrays(arrays, name="figure", digest="").vertex_count == 60


@pytest.mark.parametrize("change", ["sum", "sign"])
def test_weights_that_are_no_partition_of_unity_are_refused(arrays, change):
    if change == "sum":
        arrays["weights"][7] *= 1.01
    else:
        arrays["weights"][7, :2] += [-2.0, 2.0]
    with pytest.raises(BodyError, match="sum to 1"):
        body_from_arrays(arrays, name="figure", digest="")


def test_shipped_body_is_small_and_its_shapes_explain_the_samples():
    path = assets.BODIES_DIR / f"{assets.DEFAULT_BODY}.npz"
    record = json.loads(path.with_suffix(".json").read_text())
    assert path.stat().st_size <= ASSET_LIMIT_BYTES
    assert record["figures"]["explained_variance"] >= 0.95
    assert {"source", "licence", "command", "sha256"} <= record.keys()
    assert list_bodies() == [assets.DEFAULT_BODY]  # not the table of avatars beside it
    body = load_body()
    assert body.shape_count == 10
    assert body.vertex_count == record["figures"]["vertex_count"]
    height = float(np.ptp(body.v_template[:, 1]))
    assert_allclose(height, record["figures"]["height_m"], rtol=0.0, atol=1e-3)
