"""Subnormal numbers are zero within ``flushed``, in its thread and those that it starts, and nowhere else."""

from __future__ import annotations

import platform
import sys
import threading

import numpy as np
import pytest

from drape.subnormals import flushed

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or platform.machine() not in ("x86_64", "aarch64"),
    reason="Only Linux on x86-64 and arm64 is set: run it there.",
)


def product() -> float:
    """1e-40 as the processor computes it, from normal numbers."""
    return float(np.float32(1e-30) * np.float32(1e-10))


def doubled() -> float:
    """Twice 1e-40, from a number that is subnormal itself."""
    return float((np.full(4, 1e-40, dtype=np.float32) * np.float32(2.0)).max())


def elsewhere() -> float:
    """``product`` in a thread that starts now."""
    found = []
    thread = threading.Thread(target=lambda: found.append(product()))
    thread.start()
    thread.join()
    return found[0]


def test_results_and_inputs_are_zero_within_and_as_before_afterwards():
    assert product() > 0.0 and doubled() > 0.0
    with flushed():
        assert product() == doubled() == elsewhere() == 0.0
        with flushed():
            assert product() == 0.0
        assert product() == 0.0
    assert product() > 0.0 and doubled() > 0.0 and elsewhere() > 0.0


def test_another_thread_and_normal_numbers_are_as_they_were():
    inside, outside, found = threading.Event(), threading.Event(), []

    def hold() -> None:
        with flushed():
            inside.set()
            outside.wait(10.0)

    thread = threading.Thread(target=hold)
    thread.start()
    assert inside.wait(10.0)
    found.append(product())
    outside.set()
    thread.join()
    assert found[0] > 0.0
    x = np.random.default_rng(0).normal(size=1000).astype(np.float32)
    with flushed():
        within = np.exp(x) @ x
    assert within == np.exp(x) @ x


def test_an_error_leaves_the_thread_as_it_was():
    with pytest.raises(ZeroDivisionError), flushed():
        raise ZeroDivisionError
    assert product() > 0.0


def test_on_another_system_it_does_nothing(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("drape.subnormals._REGISTER", None)
    with flushed():
        assert product() > 0.0
