"""Array-namespace helpers, so that one formula serves numpy and torch."""

from __future__ import annotations

from typing import Any

import numpy as np
from array_api_compat import array_namespace as namespace
from array_api_compat import device

from drape.errors import InputError

Array = Any  # a numpy or torch array

__all__ = ["Array", "check_finite", "check_shape", "count_of", "device", "like", "namespace", "identity3"]


def check_shape(
    name: str, array: Array, shape: tuple[int | None, ...], *, error: type[InputError] = InputError
) -> None:
    """Raises ``error`` unless ``array`` has ``shape``; ``None`` admits any length on that axis."""
    got = tuple(array.shape)
    fits = len(got) == len(shape) and all(want is None or want == have for want, have in zip(shape, got, strict=True))
    if not fits:
        wanted = "(" + ", ".join("any" if want is None else str(want) for want in shape) + ")"
        raise error(
            name, expected=f"shape {wanted}", got=f"shape {got}", cure="Reshape or pad the array before passing it."
        )


def check_finite(name: str, array: np.ndarray, *, error: type[InputError] = InputError) -> None:
    """Raises ``error`` if ``array`` holds NaN or infinity, naming the first offending index."""
    bad = ~np.isfinite(array)
    if bad.any():
        index = tuple(int(i) for i in np.argwhere(bad)[0])
        raise error(
            name,
            expected="finite numbers",
            got=f"{array[index]} at index {index} ({int(bad.sum())} in all)",
            cure="Remove the NaN or infinite entries.",
        )


def like(reference: Array, value: Any) -> Array:
    """Returns ``value`` as an array of the namespace, dtype and device of ``reference``."""
    xp = namespace(reference)
    return xp.asarray(value, dtype=reference.dtype, device=device(reference))


def count_of(rows: Array, dtype: Any) -> Array:
    """Returns the number of ``rows`` (n,) as an array () of ``dtype`` on their device.

    A length read off a shape is a number of the host: in a graph on a GPU each product with it waits for a copy, and
    such a graph cannot be captured.
    """
    xp = namespace(rows)
    return xp.sum(xp.ones_like(rows, dtype=dtype), dtype=dtype)


def identity3(reference: Array) -> Array:
    """Returns identity matrices (..., 3, 3) in the dtype and on the device of ``reference`` (...).

    Stacked from ones and zeros: array-api-compat's torch ``eye`` fills in place, which ONNX export refuses.
    """
    xp = namespace(reference)
    unity = xp.ones_like(reference)
    zero = xp.zeros_like(reference)
    return xp.stack(
        [
            xp.stack([unity, zero, zero], axis=-1),
            xp.stack([zero, unity, zero], axis=-1),
            xp.stack([zero, zero, unity], axis=-1),
        ],
        axis=-2,
    )
