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
MEMORY_BYTES = 4 << 30  # limit of a session's workspace on a GPU


@dataclass(frozen=True)
class Device:
    """The processor or GPU on which graphs compute. A CPU computes with ``threads`` threads."""

    provider: Provider = "cpu"
    threads: int = 1

    def computing(self) -> AbstractContextManager[None]:
        """Returns a context for threads that open or run sessions: subnormal numbers count as zero in it.

        ONNX Runtime's own option does that for a session's own threads only.
        """
        return flushed()

    def value(self, array: np.ndarray) -> onnxruntime.OrtValue:
        """Returns ``array`` as a value of ONNX Runtime on this device; on a CPU both share their memory."""
        import onnxruntime

        return onnxruntime.OrtValue.ortvalue_from_numpy(array, self.provider)

    def options(self) -> dict[str, str]:
        """Returns ONNX Runtime's options of the provider by name. TF32 is off: it rounds products of coordinates to ten
        bits."""
        if self.provider == "cpu":
            return {}
        return {"use_tf32": "0", "gpu_mem_limit": str(MEMORY_BYTES), "arena_extend_strategy": "kSameAsRequested"}


class Session:
    """An opened part of a graph. ``inputs`` are the names of what it takes."""

    def __init__(self, opened: onnxruntime.InferenceSession, device: Device) -> None:
        self.inputs = tuple(tensor.name for tensor in opened.get_inputs())
        self._opened, self._device = opened, device

    def run(self, outputs: Sequence[str], feed: Mapping[str, Value]) -> list[np.ndarray]:
        """Returns the arrays of ``outputs``, in their order. ``feed`` has an array, or a value on the device, for each
        input by name."""
        values = {name: self._device.value(v) if isinstance(v, np.ndarray) else v for name, v in feed.items()}
        with self._device.computing():
            found = self._opened.run_with_ort_values(list(outputs), values)
        return [value.numpy() for value in found]


def check_distributions() -> str:
    """Returns the name of the ONNX Runtime distribution that is installed; refuses (``Unavailable``) none and two.

    Both put their files into the same folder: the last one installed wins, and removing one breaks the other
    (microsoft/onnxruntime#10685).
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
    """Returns a session of ``model``, the bytes of an ONNX file, on the provider of ``device``.

    ``weights``: the contents of its files of tensors by their names. All comes from memory, since parts of the packed
    graph are opened when another model may lie in the folder. Raises ``ArtifactError`` with ``label`` for bytes that
    ONNX Runtime does not open, and ``Unavailable`` where it does not use the provider.
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
    # Threads that sleep between operations of microseconds lose more than they gain, and those that spin between frames
    # burn a core: so they spin while a graph runs (docs/archive/log-2026-W47.md, two threads that sleep).
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
    """Returns how many nodes of ``session`` do not run on the provider of ``device``; on a GPU each waits for a
    copy."""
    parts = session.get_provider_graph_assignment_info()
    return sum(len(part.get_nodes()) for part in parts if part.ep_name != PROVIDER_NAMES[device.provider])
