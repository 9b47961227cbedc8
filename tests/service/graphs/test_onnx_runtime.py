"""Sessions compute with zero in place of subnormal numbers, in whichever thread, and leave that thread as it was."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from onnx import TensorProto, helper

from drape.artifacts import TensorSpec
from service.graphs.binding import BoundSession
from service.graphs.onnx_runtime import Device, Session, open_session

SMALL = np.full(4_000_000, 1e-30, np.float32)  # enough numbers for two threads to share
RUNS = 5  # where one thread comes too late to a run, it does not to all
FACTOR = np.full(1, 1e-10, np.float32)
INPUTS = (TensorSpec("x", ("n",), "float32", "1"), TensorSpec("y", (1,), "float32", "1"))


def multiplying(device: Device) -> Session:
    """z = x y for x (n,) and y (1,)."""
    x, y, z = (helper.make_tensor_value_info(*tensor) for tensor in (
        ("x", TensorProto.FLOAT, ["n"]), ("y", TensorProto.FLOAT, [1]), ("z", TensorProto.FLOAT, ["n"])
    ))  # fmt: skip
    graph = helper.make_graph([helper.make_node("Mul", ["x", "y"], ["z"])], "g", [x, y], [z])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    return Session(open_session("multiplying", model.SerializeToString(), {}, device), device)


def bound(device: Device) -> Session:
    """The same at fixed addresses."""
    return BoundSession(multiplying(device)._opened, device, INPUTS, (TensorSpec("z", ("n",), "float32", "1"),))


def in_thread(call: Callable[[], np.ndarray]) -> np.ndarray:
    """What ``call`` gives in a thread of its own, which computes as before afterwards."""
    found = []

    def work() -> None:
        found.append(call())
        assert (SMALL[:4] * FACTOR > 0.0).all()

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    return found[0]


@pytest.mark.parametrize("make", [multiplying, bound])
@pytest.mark.parametrize("threads", [1, 2])
def test_subnormal_numbers_are_zero_in_every_thread_of_a_session(make: Callable[[Device], Session], threads: int):
    opened = make(Device(threads=threads))
    feed = {"x": SMALL, "y": FACTOR}
    for run in (lambda call: call(), in_thread):
        for _ in range(RUNS):
            assert_array_equal(run(lambda: opened.run(["z"], feed)[0]), 0.0)
        assert_array_equal(run(lambda: opened.run(["z"], feed | {"x": -1e10 * SMALL})[0]), -1e10 * SMALL * FACTOR)
    assert (SMALL[:4] * FACTOR > 0.0).all()  # numpy, here
    kept = make(Device(threads=threads, keep_subnormals=True)).run(["z"], feed)[0]
    assert_array_equal(kept, SMALL * FACTOR)
    assert (kept > 0.0).all()
