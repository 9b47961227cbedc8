"""``python -m drape.warm_up`` compiles the kernels of a service and stores them, so that nothing waits for it later."""

from __future__ import annotations

import gc
import multiprocessing  # noqa: TID251 - it spawns, and before there are threads
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed  # noqa: TID251

import numpy as np

from drape.live import swing_step
from drape.live.dissection import LEAF, dissected

Parts = dict[str, Callable[[], object]]


def _dissect() -> None:
    """Cuts a ring: a small cloth needs no cut."""
    ring = np.arange(4 * LEAF, dtype=np.int32)
    start, neighbour = 2 * np.arange(len(ring) + 1, dtype=np.int32), np.stack([ring - 1, ring + 1], axis=1) % len(ring)
    dissected(start, neighbour.reshape(-1))


# The longest first.
SERVICE: Parts = {
    "swing": swing_step.warm_up,
    "dissection": _dissect,
}


def compile_all(parts: Parts) -> None:
    """Calls the ``parts`` in turn, two at a time in processes of their own, and prints a line when one has ended. What
    is stored is read."""
    start_s = time.monotonic()
    workers, context = min(2, os.cpu_count() or 1), multiprocessing.get_context("spawn")
    # A compiler keeps most of what it makes: collections as often as otherwise take a seventh of the time.
    with ProcessPoolExecutor(workers, context, gc.set_threshold, (50_000, 20, 100)) as pool:
        names = {pool.submit(part): name for name, part in parts.items()}
        for done in as_completed(names):
            done.result()
            print(f"kernels of {names[done]}: there after {time.monotonic() - start_s:.0f} s", flush=True)


if __name__ == "__main__":
    compile_all(SERVICE)
