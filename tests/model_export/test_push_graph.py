"""The push-out's graph: numpy's numbers, any garment and number of frames, and a frame by itself is the same."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.geometry.skinning import skin_points
from drape.graph.feeds import garment_feed
from drape.graph.push_feed import feed_arrays, pack_push
from drape.push.projection import push_out
from drape.push.skin import body_skin, skin_table
from model_export.export import write_push_out
from model_export.parity import hard_poses, session
from model_export.push_graph import push_inputs, push_parity_error
from tests.fixtures.packed import garment

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("push") / "push_out.onnx"
    return path, write_push_out(path)


def arrays(kind: str, poses: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Inputs of the graph for the skinned garment, and what numpy makes of them."""
    body, whole = load_body(), garment(kind)
    count = whole.vertex_count
    rest = whole.vertices[:count].astype(np.float64)
    rotations, translations = body.bones(poses)
    still, weights = np.broadcast_to(rest, (len(poses), *rest.shape)), whole.skin_weights[:count].astype(np.float64)
    vertices = skin_points(still, weights, rotations, translations)
    feed, bones = pack_push(garment_feed(whole), rest, body_skin(body)), body_skin(body).on_bones(body)
    inputs = {"vertices": vertices, "bone_rotation": rotations, "bone_translation": translations}
    inputs = {name: value.astype(np.float32) for name, value in inputs.items()}
    inputs["clearance"] = np.full(1, 0.004, dtype=np.float32)
    table = skin_table(bones.rows, bones.bones, inputs["bone_rotation"], inputs["bone_translation"])
    expected = push_out(inputs["vertices"], table, feed, 0.004)
    return inputs | {"skin_rows": bones.rows, "skin_bones": bones.bones} | feed_arrays(feed), expected


def test_the_file_says_what_the_specification_says(written):
    path, spec = written
    assert [tensor.name for tensor in onnx.load(str(path)).graph.input] == [tensor.name for tensor in push_inputs()]
    assert spec.inputs == push_inputs()
    assert path.stat().st_size < 300_000, "no constant of a garment or body may be baked in"


@pytest.mark.parametrize("kind", ["shorts", "tank"])
def test_it_is_numpys_push_out(written, kind: str):
    inputs, expected = arrays(kind, hard_poses(3, seed=4))
    got = np.asarray(session(written[0]).run(["pushed"], inputs)[0])
    assert np.abs(expected - inputs["vertices"]).max() > 1e-3, "must push for the test to mean something"
    assert_allclose(got, expected, rtol=0, atol=2e-5)


def test_a_frame_has_the_same_bits_alone_and_in_company(written):
    inputs, _ = arrays("shorts", hard_poses(4, seed=5))
    run = session(written[0])
    together = np.asarray(run.run(["pushed"], inputs)[0])
    for frame in range(4):
        one = {
            name: value[frame : frame + 1] if name in ("vertices", "bone_rotation", "bone_translation") else value
            for name, value in inputs.items()
        }
        assert_array_equal(np.asarray(run.run(["pushed"], one)[0])[0], together[frame])


def test_parity_is_measured(written):
    assert 0.0 < push_parity_error(written[0], garment("tank")) < 2e-5
