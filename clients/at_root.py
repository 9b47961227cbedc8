"""Calls whose positions count from each frame's root, which the answer then holds beside them."""

from __future__ import annotations

import httpx
import numpy as np

from clients.calls import Call


def at_root(call: Call[np.ndarray]) -> Call[tuple[np.ndarray, np.ndarray]]:
    """``call`` for vertices [m] (F, V, 3) float32 counted from the roots [m] (F, 3) float64, and these."""

    def read(response: httpx.Response) -> tuple[np.ndarray, np.ndarray]:
        vertices = call.read(response)
        return vertices, np.frombuffer(response.content, dtype="<f8", offset=vertices.nbytes).reshape(-1, 3)

    return Call(call.method, call.path, read, headers=call.headers, json=call.json | {"origin": "root"}, clip=call.clip)
