"""The push-out's graphs: numpy's numbers, any garments and frames, and a frame by itself is the same."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from model_export.parity import layer_case, parity_poses, push_case, push_parity_error, session
from model_export.push.push_graphs import PUSHES, graph_path, trace_graph, write_push
from tests.fixtures.packed import garment

pytestmark = pytest.mark.slow
PER_FRAME = ("vertices", "under", "bone_rotation", "bone_translation")
POSES = parity_poses(3, seed=4)
CASES = {  # graph, inputs and what numpy makes of them, how far something must be pushed for the test to mean something
    "shorts": lambda: ("push_out", push_case(garment("shorts"), POSES, clearance_m=0.004), 1e-3),
    "tank": lambda: ("push_out", push_case(garment("tank"), POSES, clearance_m=0.004), 1e-3),
    "shorts over tank": lambda: ("push_over", layer_case(garment("shorts"), garment("tank"), POSES, 0.004), 5e-3),
    "tank over trousers": lambda: ("push_over", layer_case(garment("tank"), garment("trousers"), POSES, 0.004), 5e-3),
}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("push")
    return folder, {name: write_push(name, folder) for name in PUSHES}


@pytest.mark.parametrize("name", PUSHES)
def test_the_file_says_what_the_specification_says(written, name: str):
    folder, specs = written
    path = folder / f"{name}.onnx"
    inputs = PUSHES[name].inputs
    assert [tensor.name for tensor in onnx.load(str(path)).graph.input] == [tensor.name for tensor in inputs]
    assert specs[name].inputs == inputs
    assert path.stat().st_size < 300_000, "no constant of a garment or body may be baked in"


@pytest.mark.parametrize("case", CASES)
def test_it_is_numpys_push_out_and_frames_are_independent(written, case: str):
    name, (arrays, expected), pushed_m = CASES[case]()
    run = session(written[0] / f"{name}.onnx")
    got = np.asarray(run.run(["pushed"], arrays)[0])
    assert np.abs(expected - arrays["vertices"]).max() > pushed_m
    assert_allclose(got, expected, rtol=0, atol=2e-5)
    for frame in range(len(POSES)):
        one = {key: value[frame : frame + 1] if key in PER_FRAME else value for key, value in arrays.items()}
        assert_array_equal(np.asarray(run.run(["pushed"], one)[0])[0], got[frame])


@pytest.mark.parametrize("name", PUSHES)
def test_lengths_are_read_off_small_inputs_that_a_cut_graph_keeps(written, name: str):
    """The service gives the posed skin in place of its rows and of rotations."""
    nodes = onnx.load(str(written[0] / f"{name}.onnx")).graph.node
    read = {node.input[0] for node in nodes if node.op_type == "Shape"}
    assert {"bone_translation", "skin_bones"} <= read
    assert read.isdisjoint({"bone_rotation", "skin_rows", "push_other"})


def test_parity_is_measured(written):
    assert 0.0 < push_parity_error(written[0], garment("tank")) < 2e-5


@pytest.mark.long
@pytest.mark.parametrize("name", PUSHES)
def test_the_stored_graph_is_traced_from_this_code(name: str):
    assert trace_graph(name) == graph_path(name).read_bytes(), "python -m model_export.push stores it anew"
