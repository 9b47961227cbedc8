"""Opens a model folder, checks it, runs its graphs (``service.runtime``, ``service.binding``)."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drape.artifacts import GraphSpec, Manifest, load_manifest
from drape.body.model import BodyModel
from drape.errors import ArtifactError, InputError
from drape.packing import pass_name
from service.binding import BoundSession
from service.runtime import Device, Session, check_distributions, nodes_elsewhere, open_session
from service.subgraph import cut

if TYPE_CHECKING:
    import onnxruntime

ENCODER, DRAPE, PACKED, DYNAMIC = "garment_encoder", "drape", "packed", "dynamic_encoder"
ROUNDED, HALF = "packed_int8", "packed_half"  # in place of the packed graph, on processors and on GPUs
PUSH, PUSH_OVER = "push_out", "push_over"
FIRST = "patch_first"  # output of the encoder that the packed graph reads
SKIN = "skin"  # output of the graphs that pose it
SKIN_CONSTANTS = ("skin_rows", "skin_bones")  # inputs of those, of a body's shape
JETS = ("jet", "frame_rotation", "frame_centre")  # outputs of the graphs that drape
REQUIRED_OUTPUTS = {ENCODER: {"patch_embedding"}, DRAPE: {"vertices"}, DYNAMIC: {"dynamic_code", "next_state"}}
# ONNX Runtime's names for element types.
_TYPES = {
    "float32": "tensor(float)",
    "float64": "tensor(double)",
    "float16": "tensor(float16)",
    "int16": "tensor(int16)",
    "int64": "tensor(int64)",
    "int32": "tensor(int32)",
    "uint16": "tensor(uint16)",
    "uint8": "tensor(uint8)",
}


class Engine:
    """An opened model, static or dynamic. Each of its graphs is safe to run from one thread at a time.

    Of a ``dynamic`` model the drape graph also takes ``dynamic_code`` (F, ``code_size``), zeros for bodies at rest.
    Where the model has them, the packed graph is the one in ``int8`` on a CPU, and the one with weights of 16 bits
    (``half``) on a GPU. ``bound``: parts of graphs run in buckets (``service.binding``), by default on a GPU.
    """

    def __init__(
        self,
        folder: Path,
        *,
        device: Device | None = None,
        int8: bool = True,
        half: bool | None = None,
        bound: bool | None = None,
    ) -> None:
        check_distributions()
        self._device = device or Device()
        on_gpu = self._device.provider == "cuda"
        self.bound = on_gpu if bound is None else bound
        self.manifest: Manifest = load_manifest(folder)
        self.dynamic = self.manifest.dynamic
        graphs = (ENCODER, DRAPE, DYNAMIC) if self.dynamic else (ENCODER, DRAPE)
        for name in graphs:
            if name not in self.manifest.graphs:
                raise ArtifactError(
                    f"{folder.name} graphs",
                    expected=f"a graph {name!r}",
                    got=str(sorted(self.manifest.graphs)),
                    cure="Export the model again.",
                )
        self.state_size = self.manifest.state_size
        self.code_size = _code_size(folder.name, self.manifest)
        self.feels_body = "body_skin" in {tensor.name for tensor in self.manifest.graphs[DRAPE].inputs}
        # Read now: a folder replaced later must not mix its graphs with those of this one.
        self.int8 = int8 and not on_gpu and self.packs and ROUNDED in self.manifest.graphs
        self.half = (on_gpu if half is None else half) and self.packs and HALF in self.manifest.graphs
        self.elsewhere = 0  # nodes of parts opened so far that do not run on the provider; each waits for a copy
        cuttable = [self._chosen(name) for name in (PACKED, PUSH, PUSH_OVER) if name in self.manifest.graphs]
        self._files = {name: (folder / self.manifest.graphs[name].file).read_bytes() for name in cuttable}
        weights = self.manifest.weights
        self._weights = {weights.file: (folder / weights.file).read_bytes()} if weights else {}
        self._sessions = {
            name: _open(folder, name, self.manifest.graphs[name], self._weights, self._device) for name in graphs
        }
        self.provider: str = self._sessions[DRAPE].get_providers()[0]

    def _chosen(self, graph: str) -> str:
        """The graph that computes ``graph``."""
        if graph != PACKED:
            return graph
        return HALF if self.half else ROUNDED if self.int8 else PACKED

    def check_body(self, body: BodyModel) -> None:
        """Refuses a body that the model was not trained on."""
        if body.digest != self.manifest.body_digest:
            raise ArtifactError(
                f"{self.manifest.name} body_digest",
                expected=f"{self.manifest.body_digest} ({self.manifest.body})",
                got=f"{body.digest} ({body.name})",
                cure="Set DRAPE_BODY to the model's body, or export a model for this body.",
            )

    def embed(self, patch_features: np.ndarray) -> np.ndarray:
        """What the drape graph reads of a garment's patches, (K, E) float32; constant per garment and model."""
        features = np.ascontiguousarray(patch_features, dtype=np.float32)
        wanted = self.manifest.graphs[ENCODER].inputs[0].shape[-1]
        if isinstance(wanted, int) and features.shape[-1] != wanted:
            raise ArtifactError(
                "garment patch_features",
                expected=f"{wanted} numbers per patch (model {self.manifest.name})",
                got=str(features.shape[-1]),
                cure="Run the intake of this release again.",
            )
        return self._run(ENCODER, {"patch_features": features}, ["patch_embedding"])[0]

    def drape(self, feed: dict[str, np.ndarray]) -> np.ndarray:
        """Vertices [m] (F, V, 3) float32 relative to the root joint, for the graph's inputs ``feed``."""
        return self.drape_outputs(feed, ["vertices"])[0]

    def drape_outputs(self, feed: dict[str, np.ndarray], outputs: Sequence[str]) -> list[np.ndarray]:
        """``outputs`` of the drape graph for its inputs ``feed``; refuses (``ArtifactError``) numbers not finite."""
        found = self._run(DRAPE, feed, list(outputs))
        check_finite(self, all(bool(np.isfinite(array).all()) for array in found))
        return found

    @property
    def tells_jets(self) -> bool:
        """Whether the graph that drapes says the jets that its vertices are made of, and their frames."""
        graph = self.manifest.graphs[PACKED if self.packs else DRAPE]
        return set(JETS) <= {tensor.name for tensor in graph.outputs}

    def advance(self, features: np.ndarray, state: np.ndarray, dt_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Codes (n, C) and next states (n, H), float32, of motion (n, 24, 12), states (n, H) and steps (n,) [s]."""
        inputs = {"motion_features": features, "state": state, "dt_s": dt_s}
        feed = {name: np.ascontiguousarray(value, dtype=np.float32) for name, value in inputs.items()}
        code, after = self._run(DYNAMIC, feed, ["dynamic_code", "next_state"])
        if not (np.isfinite(code).all() and np.isfinite(after).all()):
            raise ArtifactError(
                f"{self.manifest.name} next_state",
                expected="finite numbers",
                got="NaN or infinity",
                cure="Use another model, or motion 0; this one fails on the motion.",
            )
        return code, after

    @property
    def packs(self) -> bool:
        """Whether the model has the packed graph."""
        return PACKED in self.manifest.graphs and FIRST in {t.name for t in self.manifest.graphs[ENCODER].outputs}

    @property
    def pass_count(self) -> int:
        """Corrections of which a scene may choose how many run; 0 where the model leaves no choice."""
        outputs = {t.name for t in self.manifest.graphs[PACKED].outputs} if self.packs else set()
        return next(count for count in range(len(outputs) + 1) if pass_name(count + 1) not in outputs)

    def check_passes(self, passes: int | None) -> int | None:
        """``passes``, None where that is all of them; refuses (``InputError``) what the model cannot do."""
        count = self.pass_count
        if passes is not None and not 0 <= passes <= count:
            expected = f"0 to {count}" if count else f"none: the passes of model {self.manifest.name} are fixed"
            raise InputError("passes", expected=expected, got=str(passes), cure="Leave it out for all passes.")
        return None if passes == count else passes

    @property
    def pushes(self) -> bool:
        """Whether the model has the push-out's graph."""
        return PUSH in self.manifest.graphs

    @property
    def pushes_over(self) -> bool:
        """Whether the model has the graph that pushes garments out of those below them."""
        return PUSH_OVER in self.manifest.graphs

    @property
    def shares_skin(self) -> bool:
        """Whether the packed graph says the posed skin that it feels, and the push-outs' can take it."""
        graphs = [self.manifest.graphs.get(name) for name in (PACKED, PUSH, PUSH_OVER)]
        return all(graph is not None and SKIN in {tensor.name for tensor in graph.outputs} for graph in graphs)

    def tells_jet_push(self, graph: str) -> bool:
        """Whether the push-out's ``graph`` is there and says what of it jets can carry."""
        spec = self.manifest.graphs.get(graph)
        return spec is not None and {"jet_push", "left"} <= {tensor.name for tensor in spec.outputs}

    def first(self, patch_features: np.ndarray) -> np.ndarray:
        """What the packed graph reads of a garment's patches, (K, n) float32; constant per garment and model."""
        if not self.packs:
            raise ArtifactError(
                f"{self.manifest.name} graphs",
                expected=f"a graph {PACKED!r} and an encoder with {FIRST!r}",
                got=str(sorted(self.manifest.graphs)),
                cure="Export the model again.",
            )
        features = np.ascontiguousarray(patch_features, dtype=np.float32)
        return self._run(ENCODER, {"patch_features": features}, [FIRST])[0]

    def open_cut(
        self,
        graph: str,
        outputs: Sequence[str],
        *,
        direct: Collection[str] = (),
        passes: int | None = None,
        given: Collection[str] = (),
    ) -> Session:
        """A session of what ``outputs`` of ``graph`` need and nothing else (``service.subgraph``).

        Of the packed graph, after ``passes`` corrections; all of them by default. ``given`` outputs are inputs.
        """
        graph = self._chosen(graph)
        name, spec = self.manifest.name, self.manifest.graphs[graph]
        passes = self.check_passes(passes)
        instead = None if passes is None else {pass_name(self.pass_count): pass_name(passes)}
        model = cut(self._files[graph], outputs, direct=direct, instead=instead, given=given)
        # Operations of the push-outs are too small to be shared: two threads take longer than one.
        device = replace(self._device, threads=1) if graph in (PUSH, PUSH_OVER) else self._device
        session = open_session(f"{name}/{spec.file}", model, self._weights, device, capture=device.captures)
        self.elsewhere += nodes_elsewhere(session, device)
        found = {t.name: t.type for t in session.get_inputs()}
        taken = (*spec.inputs, *(t for t in spec.outputs if t.name in given))
        _compare(name, graph, "inputs", {t.name: t.dtype for t in taken if t.name in found}, found)
        found = {t.name: t.type for t in session.get_outputs()}
        _compare(name, graph, "outputs", {t.name: t.dtype for t in spec.outputs if t.name in found}, found)
        return BoundSession(session, device, taken, spec.outputs) if self.bound else Session(session, device)

    def value(self, array: np.ndarray) -> onnxruntime.OrtValue:
        """``array`` where the graphs compute; on the CPU it shares the array's memory."""
        return self._device.value(array)

    def _run(self, graph: str, feed: dict[str, np.ndarray], outputs: list[str]) -> list[Any]:
        wanted = [tensor.name for tensor in self.manifest.graphs[graph].inputs]
        with self._device.computing():
            return list(self._sessions[graph].run(outputs, {name: feed[name] for name in wanted}))


def _code_size(model: str, manifest: Manifest) -> int:
    """Numbers of a dynamic code, 0 of a static model; refuses graphs that are not what the manifest says."""
    drapes = [manifest.graphs[name] for name in (DRAPE, PACKED) if name in manifest.graphs]
    codes = {{t.name: t.shape[-1] for t in graph.inputs}.get("dynamic_code", 0) for graph in drapes}
    states = [t.shape[-1] for t in manifest.graphs[DYNAMIC].inputs if t.name == "state"] if manifest.dynamic else [0]
    code = next(iter(codes))
    fits = len(codes) == 1 and (code != 0) == manifest.dynamic and states == [manifest.state_size]
    if not fits or not isinstance(code, int):
        raise ArtifactError(
            f"{model} dynamic",
            expected="drape graphs with a dynamic_code and a state of state_size, or neither",
            got=f"dynamic {manifest.dynamic}, dynamic_code of {codes}, states {states} and {manifest.state_size}",
            cure="Export the model again.",
        )
    return code


def check_finite(engine: Engine, finite: bool) -> None:
    """Refuses an answer of the network that holds NaN or infinity."""
    if not finite:
        raise ArtifactError(
            f"{engine.manifest.name} vertices",
            expected="finite numbers",
            got="NaN or infinity",
            cure="Use another model; this one fails on the pose.",
        )


def _open(
    folder: Path, name: str, spec: GraphSpec, weights: dict[str, bytes], device: Device
) -> onnxruntime.InferenceSession:
    """A session of one graph whose tensors are those of the manifest, on the provider that was asked for."""
    session = open_session(f"{folder.name}/{spec.file}", str(folder / spec.file), weights, device)
    _compare(
        folder.name,
        name,
        "inputs",
        {t.name: t.dtype for t in spec.inputs},
        {t.name: t.type for t in session.get_inputs()},
    )
    _compare(
        folder.name,
        name,
        "outputs",
        {t.name: t.dtype for t in spec.outputs},
        {t.name: t.type for t in session.get_outputs()},
    )
    missing = REQUIRED_OUTPUTS[name] - {tensor.name for tensor in spec.outputs}
    if missing:
        raise ArtifactError(
            f"{folder.name} {name} outputs",
            expected=", ".join(sorted(missing)),
            got="none",
            cure="Export the model again.",
        )
    return session


def _compare(model: str, graph: str, side: str, written: dict[str, str], found: dict[str, str]) -> None:
    if set(written) != set(found):
        raise ArtifactError(
            f"{model} {graph} {side}",
            expected=f"{sorted(written)} as in the manifest",
            got=str(sorted(found)),
            cure="Export the model again.",
        )
    for name, dtype in written.items():
        if _TYPES.get(dtype) != found[name]:
            raise ArtifactError(
                f"{model} {graph} {name}",
                expected=f"{dtype} as in the manifest",
                got=found[name],
                cure="Export the model again.",
            )
