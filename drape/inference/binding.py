"""Sessions whose inputs and outputs stay at fixed addresses, as a captured CUDA graph needs them.

A *bucket* is the memory for one set of shapes: a value per input that a call writes into, and one per output. On a GPU
the first call of a bucket is captured under an id of its own, and later ones replay it: hundreds of launches become
one. Inputs that are values already (constants of the store) are bound as they are, and belong to the bucket too.
Buckets are dropped, oldest first, where they would take more than a limit.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

from drape.artifacts import TensorSpec
from drape.contact.samples import POSED_REGIONS
from drape.errors import ArtifactError
from drape.inference.onnx_runtime import Device, Session

if TYPE_CHECKING:
    import onnxruntime

    from drape.inference.onnx_runtime import Value

KEPT_BUCKETS = 32
KEPT_BYTES = 512 << 20


@dataclass(eq=False)
class _Bucket:
    """Memory of one set of shapes: what calls write (``inputs``), with what it holds, and read (``outputs``)."""

    binding: Any
    options: Any
    capture_id: int
    inputs: dict[str, onnxruntime.OrtValue]
    outputs: dict[str, onnxruntime.OrtValue]
    fixed: tuple[onnxruntime.OrtValue, ...]  # kept alive: their places in memory are part of a captured graph
    bytes: int
    held: dict[str, np.ndarray] = field(default_factory=dict)


class BoundSession(Session):
    """Runs a session in buckets; ``inputs_of`` and ``outputs_of`` are the tensors of its graph, with named axes."""

    def __init__(
        self,
        opened: onnxruntime.InferenceSession,
        device: Device,
        inputs_of: Collection[TensorSpec],
        outputs_of: Collection[TensorSpec],
        *,
        kept_buckets: int = KEPT_BUCKETS,
        kept_bytes: int = KEPT_BYTES,
    ) -> None:
        super().__init__(opened, device)
        self._inputs = {tensor.name: tensor for tensor in inputs_of}
        self._outputs = {tensor.name: tensor for tensor in outputs_of}
        self._buckets: OrderedDict[tuple[Any, ...], _Bucket] = OrderedDict()
        self._limits = kept_buckets, kept_bytes
        self._ids = count(1)  # never one twice: a replay reads where its capture read

    @property
    def buckets(self) -> int:
        """The number of buckets: sets of shapes that have memory."""
        return len(self._buckets)

    @property
    def bytes(self) -> int:
        """The memory of all buckets [bytes]."""
        return sum(bucket.bytes for bucket in self._buckets.values())

    def run(
        self, outputs: Sequence[str], feed: Mapping[str, Value], *, unchanging: Collection[str] = ()
    ) -> list[np.ndarray]:
        """Returns the arrays of ``outputs`` for ``feed``, in their order.

        An array that ``unchanging`` names is copied in once, and not again while the same array is fed.
        """
        bucket = self._bucket(tuple(outputs), feed)
        for name, value in bucket.inputs.items():
            array = feed[name]
            assert isinstance(array, np.ndarray)
            if name in unchanging and _same(bucket.held.get(name), array):
                continue
            value.update_inplace(np.ascontiguousarray(array))
            if name in unchanging:
                bucket.held[name] = array
        with self._device.computing():
            self._opened.run_with_iobinding(bucket.binding, bucket.options)
        # On a CPU an array is the value's own memory, which the next call writes.
        copied = self._device.provider == "cpu"
        return [value.numpy().copy() if copied else value.numpy() for value in bucket.outputs.values()]

    def forget(self) -> None:
        """Drops all buckets."""
        while self._buckets:
            self._drop()

    def _bucket(self, outputs: tuple[str, ...], feed: Mapping[str, Value]) -> _Bucket:
        places = tuple(
            (name, value.shape if isinstance(value, np.ndarray) else id(value)) for name, value in feed.items()
        )
        bucket = self._buckets.pop((outputs, places), None)
        if bucket is None:
            bucket = self._made(outputs, feed)
        self._buckets[outputs, places] = bucket
        kept_buckets, kept_bytes = self._limits
        while len(self._buckets) > 1 and (len(self._buckets) > kept_buckets or self.bytes > kept_bytes):
            self._drop()
        return bucket

    def _drop(self) -> None:
        _, bucket = self._buckets.popitem(last=False)
        if self._device.captures:
            self._opened.release_captured_graph(bucket.capture_id)

    def _made(self, outputs: tuple[str, ...], feed: Mapping[str, Value]) -> _Bucket:
        import onnxruntime

        capture_id = next(self._ids)
        options = onnxruntime.RunOptions()
        options.add_run_config_entry("gpu_graph_id", str(capture_id))
        binding, sizes = self._opened.io_binding(), self._sizes(feed)
        values_in: dict[str, onnxruntime.OrtValue] = {}
        fixed = []
        for name, value in feed.items():
            if isinstance(value, np.ndarray):
                value = values_in[name] = self._device.empty(value.shape, value.dtype)
            else:
                fixed.append(value)
            binding.bind_ortvalue_input(name, value)
        values_out = {}
        for name in outputs:
            tensor = self._outputs[name]
            shape = [size if isinstance(size, int) else sizes[size] for size in tensor.shape]
            values_out[name] = self._device.empty(shape, np.dtype(tensor.dtype))
            binding.bind_ortvalue_output(name, values_out[name])
        size = sum(value.tensor_size_in_bytes() for value in (*values_in.values(), *values_out.values()))
        return _Bucket(binding, options, capture_id, values_in, values_out, tuple(fixed), size)

    def _sizes(self, feed: Mapping[str, Value]) -> dict[str, int]:
        """Lengths of the named axes in ``feed``; refuses (``ArtifactError``) inputs that do not agree."""
        sizes: dict[str, int] = {}
        for name, value in feed.items():
            shape = value.shape if isinstance(value, np.ndarray) else value.shape()
            tensor = self._inputs[name]
            for axis, length in zip(tensor.shape, shape, strict=True):
                wanted = axis if isinstance(axis, int) else sizes.setdefault(axis, length)
                if length != wanted:
                    raise ArtifactError(
                        f"input {name}",
                        expected=f"{axis} {wanted}" if isinstance(axis, str) else str(tensor.shape),
                        got=str(tuple(shape)),
                        cure="Feed arrays of one batch.",
                    )
        if "parts" in sizes:
            sizes["regions"] = POSED_REGIONS * sizes["parts"]
        return sizes


def _same(held: np.ndarray | None, array: np.ndarray) -> bool:
    """Whether both are one piece of memory, of one shape."""
    if held is None or held.shape != array.shape or held.strides != array.strides:
        return False
    return held.__array_interface__["data"][0] == array.__array_interface__["data"][0]
