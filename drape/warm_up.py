"""``python -m drape.warm_up`` compiles the kernels of a service and stores them, so that nothing waits for it later."""

from __future__ import annotations

import gc
import multiprocessing  # noqa: TID251 - it spawns, and before there are threads
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed  # noqa: TID251

import numpy as np

from drape.graph import blend
from drape.kernels.quantised import quantise
from drape.live import fold_step, two_level
from drape.network import warm_up as network

Parts = dict[str, Callable[[], object]]


def _messages() -> None:
    quantise(np.zeros((1, 3), np.float32))


# The longest first. The last one calls kernels that the others have compiled by then.
SERVICE: Parts = {
    "folds": fold_step.warm_up,
    "network": network.warm_up,
    "lift": two_level.warm_up_lift,
    "vertices": blend.warm_up,
    "messages": _messages,
    "folds in two levels": two_level.warm_up,
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
