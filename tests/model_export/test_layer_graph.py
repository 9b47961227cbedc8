"""The graph of garments over others: numpy's numbers, any garments and frames, and a frame by itself is the same."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from model_export.export import write_push_over
from model_export.layer_graph import layer_case, layer_inputs, layer_parity_error
from model_export.parity import hard_poses, session
from tests.fixtures.packed import garment

pytestmark = pytest.mark.slow
PER_FRAME = ("vertices", "under", "bone_rotation", "bone_translation")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("push") / "push_over.onnx"
    return path, write_push_over(path)


def test_the_file_says_what_the_specification_says(written):
    path, spec = written
    assert [tensor.name for tensor in onnx.load(str(path)).graph.input] == [tensor.name for tensor in layer_inputs()]
    assert spec.inputs == layer_inputs()
    assert path.stat().st_size < 300_000, "no constant of a garment or body may be baked in"


@pytest.mark.parametrize(("outer", "inner"), [("shorts", "tank"), ("tank", "trousers")])
def test_it_is_numpys_push_out_and_frames_are_independent(written, outer: str, inner: str):
    arrays, expected = layer_case(garment(outer), garment(inner), hard_poses(3, seed=4), clearance_m=0.004)
    run = session(written[0])
    got = np.asarray(run.run(["pushed"], arrays)[0])
    assert np.abs(expected - arrays["vertices"]).max() > 5e-3, "must push for the test to mean something"
    assert_allclose(got, expected, rtol=0, atol=2e-5)
    for frame in range(3):
        one = {name: value[frame : frame + 1] if name in PER_FRAME else value for name, value in arrays.items()}
        assert_array_equal(np.asarray(run.run(["pushed"], one)[0])[0], got[frame])


def test_parity_is_measured(written):
    assert 0.0 < layer_parity_error(written[0], garment("tank")) < 2e-5
