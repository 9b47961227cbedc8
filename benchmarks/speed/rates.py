"""What this processor does at best: multiply-adds of matrices and bytes of copies in a second. Floors rest on them."""

from __future__ import annotations

from functools import cache

import torch

from benchmarks.clock import timed

WIDTH = 1024  # of the matrices
SECONDS = 0.05  # of a copy's measurement


@cache
def multiply_adds_per_s(threads: int) -> float:
    """Multiply-adds a second of a product of two large float32 matrices."""
    torch.set_num_threads(threads)
    a, b = torch.rand(WIDTH, WIDTH), torch.rand(WIDTH, WIDTH)
    return WIDTH**3 / (1e-3 * timed(lambda: a @ b, seconds=1.0))


def copied_per_s(moved: int, threads: int) -> float:
    """Bytes a second, read and written, of copies that move about so many bytes each, from and to the same memory."""
    return _copied_per_s(max(1 << 12, 1 << (moved - 1).bit_length()), threads)


@cache
def _copied_per_s(moved: int, threads: int) -> float:
    torch.set_num_threads(threads)
    source = torch.rand(moved // 8)
    target = torch.empty_like(source)
    return moved / (1e-3 * timed(lambda: target.copy_(source), seconds=SECONDS))
