"""Weights in one file: every content once, the same bits out, and the network's parameters found in it by name."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest
from numpy.testing import assert_array_equal
from onnx import TensorProto, helper, numpy_helper
from onnx.external_data_helper import ExternalDataInfo

from drape.artifacts import MODELS_DIR, GraphSpec, TensorSpec, file_digest, load_manifest, read_parameters
from model_export.parity import session
from model_export.shared_weights import ALIGNMENT, LEAST_BYTES, WEIGHTS_FILE, share_weights

DRAW = np.random.default_rng(7)
WIDE = DRAW.normal(size=(192, 512)).astype(np.float32)  # a Gemm's matrix of the shipped packed graph has this shape
SAME = DRAW.normal(size=(192, 192)).astype(np.float32)
BIAS = DRAW.normal(size=192).astype(np.float32)  # 768 bytes: stays inside
IN, OUT = TensorSpec("x", ("n", 512), "float32"), TensorSpec("y", ("n", 192), "float32")


def graph(nodes: list[onnx.NodeProto], constants: dict[str, np.ndarray]) -> onnx.ModelProto:
    """x (n, 512) -> y (n, 192) by ``nodes``, each with a note of where it comes from."""
    for node in nodes:
        node.doc_string = "def forward"
        node.metadata_props.add(key="stack", value="line 3")
    values = [helper.make_tensor_value_info(t.name, TensorProto.FLOAT, list(t.shape)) for t in (IN, OUT)]
    made = helper.make_graph(
        nodes, "g", values[:1], values[1:], [numpy_helper.from_array(v, k) for k, v in constants.items()]
    )
    made.metadata_props.add(key="stack", value="line 1")
    return helper.make_model(made, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)


def readable() -> onnx.ModelProto:
    nodes = [
        helper.make_node("MatMul", ["x", "wide"], ["a"]),
        helper.make_node("Add", ["a", "bias"], ["b"]),
        helper.make_node("MatMul", ["b", "same"], ["y"]),
    ]
    return graph(nodes, {"wide": np.ascontiguousarray(WIDE.T), "bias": BIAS, "same": SAME})


def packed(**more: np.ndarray) -> onnx.ModelProto:
    """The same, its first matrix the other way round."""
    nodes = [
        helper.make_node("Gemm", ["x", "w", "bias"], ["b"], transB=1, alpha=1.0),
        helper.make_node("MatMul", ["b", "same"], ["y"]),
    ]
    return graph(nodes, {"w": WIDE, "bias": BIAS, "same": SAME, **more})


def write(folder: Path, **models: onnx.ModelProto) -> dict[str, GraphSpec]:
    folder.mkdir()
    for key, model in models.items():
        onnx.save(model, str(folder / f"{key}.onnx"))
    return {key: GraphSpec(f"{key}.onnx", file_digest(folder / f"{key}.onnx"), 20, (IN,), (OUT,)) for key in models}


def run(path: Path, rows: int) -> np.ndarray:
    x = np.random.default_rng(rows).normal(size=(rows, 512)).astype(np.float32)
    return np.asarray(session(path).run(["y"], {"x": x})[0])


def places(path: Path) -> dict[str, tuple[int, int]]:
    """Where tensors of the graph ``path`` that lie outside begin, and their lengths [bytes]."""
    tensors = onnx.load(str(path), load_external_data=False).graph.initializer
    outside = {t.name: ExternalDataInfo(t) for t in tensors if t.data_location == TensorProto.EXTERNAL}
    assert {info.location for info in outside.values()} <= {WEIGHTS_FILE}
    return {name: (info.offset or 0, info.length or 0) for name, info in outside.items()}


@pytest.fixture
def shared(tmp_path: Path) -> tuple[Path, dict[str, GraphSpec]]:
    """Both graphs around one file, and what a manifest would say of them."""
    graphs = write(tmp_path / "m", packed=packed(), drape=readable())
    graphs, weights = share_weights(tmp_path / "m", graphs)
    assert weights is not None and weights.sha256 == file_digest(tmp_path / "m" / WEIGHTS_FILE)
    return tmp_path / "m", graphs


def test_every_content_lies_there_once_and_aligned(shared: tuple[Path, dict[str, GraphSpec]]):
    folder, graphs = shared
    drape, borrowed = (places(folder / graphs[key].file) for key in ("drape", "packed"))
    assert drape == {"wide": (0, WIDE.nbytes), "same": (WIDE.nbytes, SAME.nbytes)}
    assert borrowed == {"w": drape["wide"], "same": drape["same"]}
    assert all(offset % ALIGNMENT == 0 for offset, _ in drape.values())
    content = (folder / WEIGHTS_FILE).read_bytes()
    assert content == WIDE.T.tobytes() + SAME.tobytes()
    assert {key: file_digest(folder / spec.file) for key, spec in graphs.items()} == {
        key: spec.sha256 for key, spec in graphs.items()
    }


def test_odd_lengths_are_filled_up_to_the_next_place(tmp_path: Path):
    odd = DRAW.normal(size=LEAST_BYTES // 4 + 1).astype(np.float32)
    whole = DRAW.normal(size=LEAST_BYTES // 4).astype(np.float32)
    least = {"odd": odd, "whole": whole, "small": whole[:-1]}
    share_weights(tmp_path / "m", write(tmp_path / "m", drape=graph([], least)))
    assert places(tmp_path / "m" / "drape.onnx") == {
        "odd": (0, LEAST_BYTES + 4),
        "whole": (LEAST_BYTES + ALIGNMENT, LEAST_BYTES),
    }
    read = onnx.load(str(tmp_path / "m" / "drape.onnx")).graph.initializer
    for tensor in read:
        assert_array_equal(numpy_helper.to_array(tensor), least[tensor.name])


def test_no_bit_of_a_result_changes(shared: tuple[Path, dict[str, GraphSpec]], tmp_path: Path):
    write(tmp_path / "old", packed=packed(), drape=readable())
    (turned,) = [n for n in onnx.load(str(shared[0] / "packed.onnx")).graph.node if n.op_type == "Gemm"]
    assert {a.name: helper.get_attribute_value(a) for a in turned.attribute} == {"transB": 0, "alpha": 1.0}
    for rows in (1, 2, 3, 7, 100):
        for file in ("packed.onnx", "drape.onnx"):
            assert run(shared[0] / file, rows).tobytes() == run(tmp_path / "old" / file, rows).tobytes()


def test_a_graph_that_weights_are_read_from_keeps_its_form(tmp_path: Path):
    share_weights(tmp_path / "m", write(tmp_path / "m", drape=readable(), garment_encoder=packed()))
    (gemm, _) = onnx.load(str(tmp_path / "m" / "garment_encoder.onnx")).graph.node
    assert {a.name: a.i for a in gemm.attribute}["transB"] == 1
    drape, encoder = (places(tmp_path / "m" / f"{key}.onnx") for key in ("drape", "garment_encoder"))
    assert encoder["same"] == drape["same"] and encoder["w"] != drape["wide"]


def test_a_matrix_that_others_read_too_is_not_turned(tmp_path: Path):
    model = packed()
    model.graph.node.append(helper.make_node("Neg", ["w"], ["z"]))
    share_weights(tmp_path / "m", write(tmp_path / "m", drape=readable(), packed=model))
    read = {t.name: t for t in onnx.load(str(tmp_path / "m" / "packed.onnx")).graph.initializer}
    assert_array_equal(numpy_helper.to_array(read["w"]), WIDE)


def test_call_stacks_of_the_export_are_left_out(shared: tuple[Path, dict[str, GraphSpec]]):
    for key in ("drape", "packed"):
        made = onnx.load(str(shared[0] / f"{key}.onnx")).graph
        assert not any(part.doc_string or part.metadata_props for part in (made, *made.node))


def test_a_second_time_changes_nothing(shared: tuple[Path, dict[str, GraphSpec]]):
    folder, graphs = shared
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    again, _ = share_weights(folder, graphs)
    assert again == graphs
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_without_large_tensors_there_is_no_file(tmp_path: Path):
    graphs = write(tmp_path / "m", drape=graph([], {"bias": BIAS}))
    (tmp_path / "m" / WEIGHTS_FILE).write_bytes(b"of another model")
    assert share_weights(tmp_path / "m", graphs)[1] is None
    assert [path.name for path in (tmp_path / "m").iterdir()] == ["drape.onnx"]


# --- parameters of the network ---


def test_parameters_are_found_by_their_content_or_added(tmp_path: Path):
    graphs = write(tmp_path / "m", drape=readable())
    scalar, row = np.float32(3.0).reshape(()), BIAS[None]
    given = {"turned": WIDE, "straight": SAME, "bias": BIAS, "row": row, "scalar": scalar, "transposed": SAME.T.copy()}
    _, weights = share_weights(tmp_path / "m", graphs, given)
    assert weights is not None
    found = weights.parameters
    assert {name: (found[name].offset, found[name].turned) for name in ("turned", "straight", "transposed")} == {
        "turned": (0, True), "straight": (WIDE.nbytes, False), "transposed": (WIDE.nbytes, True),
    }  # fmt: skip
    assert found["bias"].offset == found["row"].offset
    read = read_parameters(tmp_path / "m", weights)
    assert read.keys() == given.keys()
    for name, value in given.items():
        assert_array_equal(read[name], value)
        assert read[name].flags.c_contiguous and read[name].flags.writeable
    size = (tmp_path / "m" / WEIGHTS_FILE).stat().st_size
    assert size <= WIDE.nbytes + SAME.nbytes + BIAS.nbytes + 4 + 2 * ALIGNMENT


# --- the shipped model ---


@pytest.fixture
def alone(tmp_path: Path) -> tuple[Path, dict[str, GraphSpec]]:
    """The shipped model's graphs, each with tensors of its own."""
    folder = Path(shutil.copytree(MODELS_DIR / "onefit", tmp_path / "models" / "onefit"))
    graphs = load_manifest(folder).graphs
    for spec in graphs.values():
        onnx.save(onnx.load(str(folder / spec.file)), str(folder / spec.file))
    (folder / WEIGHTS_FILE).unlink()
    return folder, graphs


def answers(folder: Path, spec: GraphSpec) -> list[bytes]:
    """Every output for drawn numbers: each named axis has three entries, every index is 0."""
    draw, feed = np.random.default_rng(2), {}
    for tensor in spec.inputs:
        shape = [3 if isinstance(axis, str) else axis for axis in tensor.shape]
        most = 0.0 if tensor.dtype.startswith("int") else 0.1  # passes stay small
        drawn = draw.uniform(0.1 * most, most, size=shape)
        feed[tensor.name] = drawn.astype(tensor.dtype)
    made = [np.asarray(value) for value in session(folder / spec.file).run(None, feed)]
    assert all(np.isfinite(value).all() for value in made)
    return [value.tobytes() for value in made]


def test_shared_weights_are_fewer_bytes_and_give_the_same_bits(
    alone: tuple[Path, dict[str, GraphSpec]], tmp_path: Path
):
    folder, graphs = alone
    before = Path(shutil.copytree(folder, tmp_path / "before"))
    shared, _ = share_weights(folder, graphs)
    for spec in shared.values():
        assert answers(folder, spec) == answers(before, spec), spec.file
    was, now = (sum(path.stat().st_size for path in folder.iterdir()) for folder in (before, folder))
    assert now < 0.8 * was


def test_the_shipped_folder_is_what_the_program_writes_and_names_no_folder_of_a_machine(
    alone: tuple[Path, dict[str, GraphSpec]],
):
    shipped = load_manifest(MODELS_DIR / "onefit")
    assert shipped.weights is not None
    parameters = read_parameters(MODELS_DIR / "onefit", shipped.weights)
    assert share_weights(*alone, parameters) == (shipped.graphs, shipped.weights)
    for path in (MODELS_DIR / "onefit").iterdir():
        content = path.read_bytes()
        if path.name != "manifest.json":
            assert content == (alone[0] / path.name).read_bytes()
        assert b'File "/' not in content
