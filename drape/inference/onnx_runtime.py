"""ONNX Runtime as the service uses it: which distribution is there, sessions on a provider, values on its device."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from drape.arrays.subnormals import flushed
from drape.errors import ArtifactError, Unavailable

if TYPE_CHECKING:
    import onnxruntime
    from onnxruntime import OrtValue

    Value = np.ndarray | OrtValue

Provider = Literal["cpu", "cuda"]

PROVIDER_NAMES: dict[Provider, str] = {"cpu": "CPUExecutionProvider", "cuda": "CUDAExecutionProvider"}
DISTRIBUTIONS = ("onnxruntime", "onnxruntime-gpu")
HOW_TO_INSTALL = "pip install onnxruntime or pip install onnx 'onnxruntime-gpu[cuda,cudnn]'"


MEMORY_BYTES = 4 << 30  # of a session's workspace on a GPU


@dataclass(frozen=True)
class Device:
    """The processor or GPU on which graphs compute.

    A CPU has ``threads``.
    """

    provider: Provider = "cpu"
    threads: int = 1

    def computing(self) -> AbstractContextManager[None]:
        """The context in which a thread runs sessions; a session's own option holds for its own threads only."""
        return flushed()

    def value(self, array: np.ndarray) -> onnxruntime.OrtValue:
        """Returns ``array`` in the memory of the device where the graphs compute; on the CPU it shares the array's
        memory.
        """
        import onnxruntime

        return onnxruntime.OrtValue.ortvalue_from_numpy(array, self.provider)

    def options(self) -> dict[str, str]:
        """The provider's options. TF32 is off: it rounds the products of coordinates to ten bits."""
        if self.provider == "cpu":
            return {}
        return {"use_tf32": "0", "gpu_mem_limit": str(MEMORY_BYTES), "arena_extend_strategy": "kSameAsRequested"}


class Session:
    """An opened part of a graph. Every call takes its memory anew, which costs nothing on a CPU."""

    def __init__(self, opened: onnxruntime.InferenceSession, device: Device) -> None:
        self.inputs = tuple(tensor.name for tensor in opened.get_inputs())
        self._opened, self._device = opened, device

    def run(self, outputs: Sequence[str], feed: Mapping[str, Value]) -> list[np.ndarray]:
        """Returns the arrays of ``outputs`` for ``feed``, whose values are numpy arrays, or values where the graph
        computes."""
        values = {name: self._device.value(v) if isinstance(v, np.ndarray) else v for name, v in feed.items()}
        with self._device.computing():
            found = self._opened.run_with_ort_values(list(outputs), values)
        return [value.numpy() for value in found]


def check_distributions() -> str:
    """The one ONNX Runtime distribution that is installed; refuses none and two.

    Both put their files in the same folder: the last one installed wins, and
    removing one breaks the other (microsoft/onnxruntime#10685).
    """
    installed = {name: version for name in DISTRIBUTIONS if (version := _version(name))}
    if len(installed) == 2:
        listed = " and ".join(f"{name} {version}" for name, version in installed.items())
        raise Unavailable(
            "onnxruntime",
            expected="one of onnxruntime and onnxruntime-gpu",
            got=f"both: {listed}",
            cure=f"Uninstall both, then install one: {HOW_TO_INSTALL}.",
        )
    if not installed:
        raise Unavailable(
            "onnxruntime",
            expected="one of onnxruntime and onnxruntime-gpu",
            got="none installed",
            cure=f"A GPU needs it, and a model that the engine does not compute. Install one: {HOW_TO_INSTALL}.",
        )
    return next(iter(installed))


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


@cache
def _load_cuda() -> None:
    """Loads the libraries of the extra gpu, once: they lie where no loader looks."""
    import onnxruntime

    if "CUDAExecutionProvider" in onnxruntime.get_available_providers():
        onnxruntime.preload_dlls()


def open_session(label: str, model: bytes, weights: dict[str, bytes], device: Device) -> onnxruntime.InferenceSession:
    """A session of the bytes ``model``, on the provider that was asked for.

    ``weights``: files of tensors outside the model, by the name that it has for them. From memory and not from the
    folder: parts of the packed graph are opened long after the rest, when another model may lie there.
    """
    import onnxruntime

    if device.provider == "cuda":
        _load_cuda()
    options = _session_options(weights, device)
    name = PROVIDER_NAMES[device.provider]
    # Only what was asked for; ONNX Runtime adds the CPU by itself where a node needs it.
    try:
        with device.computing():
            session = onnxruntime.InferenceSession(model, options, providers=[(name, device.options())])
    except Exception as error:  # the runtime raises a class of its own for each kind of damage
        raise ArtifactError(
            label,
            expected="a graph that ONNX Runtime opens",
            got=str(error).splitlines()[0],
            cure="Export the model again.",
        ) from error
    # ONNX Runtime falls back to the CPU without a word (only a log line), so what counts is what it says it uses.
    used = session.get_providers()
    if name not in used:
        raise Unavailable(
            "DRAPE_PROVIDER",
            expected=f"{name} to open",
            got=f"only {', '.join(used)}",
            cure="Install the gpu extra and a driver that fits it, or set DRAPE_PROVIDER=cpu.",
        )
    return session


def _session_options(weights: dict[str, bytes], device: Device) -> onnxruntime.SessionOptions:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = device.threads
    options.inter_op_num_threads = 1
    # Threads that sleep between operations of microseconds lose more than they gain (docs/reference/performance.md),
    # and those that spin between frames burn a core: so they spin while a graph runs.
    options.add_session_config_entry("session.intra_op.allow_spinning", "1")
    options.add_session_config_entry("session.force_spinning_stop", "1")
    options.add_session_config_entry("session.set_denormal_as_zero", "1")
    options.add_session_config_entry("session.record_ep_graph_assignment_info", "1")
    options.log_severity_level = 3
    if weights:
        sizes = [len(content) for content in weights.values()]
        options.add_external_initializers_from_files_in_memory(list(weights), list(weights.values()), sizes)
    return options


def nodes_off_provider(session: Any, device: Device) -> int:
    """Nodes of ``session`` that do not run on the provider that was asked for: on a GPU each waits for a copy."""
    parts = session.get_provider_graph_assignment_info()
    return sum(len(part.get_nodes()) for part in parts if part.ep_name != PROVIDER_NAMES[device.provider])
