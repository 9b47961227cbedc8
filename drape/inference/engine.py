"""Opens a model folder, checks it, keeps every opened part of its graphs."""

from __future__ import annotations

import threading
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drape.artifacts import GraphSpec, Manifest, TensorSpec, WeightsSpec, load_manifest, read_parameters
from drape.body.model import BodyModel
from drape.body.pose_distance import read_pose_support
from drape.cloth.fabric import Fabric
from drape.errors import ArtifactError, InputError
from drape.garment.cache import Garment
from drape.garment.fabric_features import encoder_features
from drape.graph.packing import pass_name
from drape.inference.compiled import CompiledNetwork, is_covered
from drape.inference.graph_names import (
    DRAPE,
    DYNAMIC,
    EMBEDDING,
    ENCODER,
    FIRST,
    JETS,
    PACKED,
    PUSH,
    PUSH_OVER,
    PUSHES,
    SKIN,
)
from drape.inference.onnx_runtime import (
    PROVIDER_NAMES,
    Device,
    Session,
    check_distributions,
    nodes_off_provider,
    open_session,
)
from drape.inference.subgraph import cut, misexported

if TYPE_CHECKING:
    import onnxruntime

REQUIRED_OUTPUTS = {
    DRAPE: ("vertices", *JETS),
    PACKED: ("vertices", *JETS),
    PUSH: ("pushed", "jet_push", "left", SKIN),
    PUSH_OVER: ("pushed", "jet_push", "left", SKIN),
    DYNAMIC: ("dynamic_code", "next_state"),
}
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
    """An opened model. Any thread may open a part of a graph, which is opened once; one thread at a time may run it.

    On a CPU ``drape.engine`` computes push-outs, and the network if this is of the shipped kind (``compiled``); ONNX
    Runtime is not needed then. A network of another kind runs by the readable graph with all corrections (``whole``).
    On a GPU, and for push-outs where ``pushes`` is set, the graphs run. A ``dynamic`` model takes a ``dynamic_code``
    (B, ``code_size``) for the motion of B bodies, zeros at rest, and keeps states of ``state_size`` numbers.
    Refuses (``ArtifactError``) a folder without the graphs that run.
    """

    def __init__(
        self, folder: Path, *, device: Device | None = None, compiled: bool = True, pushes: bool = False
    ) -> None:
        self._device = device or Device()
        self.on_cpu = self._device.provider == "cpu"
        self.pushes = pushes or not self.on_cpu  # whether push-outs run as graphs
        self.manifest: Manifest = load_manifest(folder)
        self.dynamic = self.manifest.dynamic
        weights, network = self.manifest.weights, self.manifest.network
        plain = compiled and not self.pushes  # no part of the packed graph is asked for
        covered = plain and weights is not None and is_covered(network)
        self.whole = plain and not covered and DRAPE in self.manifest.graphs
        self._encoded, drapes = (EMBEDDING, (DRAPE,)) if self.whole else (FIRST, (PACKED, *PUSHES))
        graphs = (ENCODER, *drapes, *((DYNAMIC,) if self.dynamic else ()))
        _check_graphs(folder.name, self.manifest, graphs, encoded=self._encoded)
        self._drapes = self.manifest.graphs[drapes[0]]
        poses = self.manifest.poses
        self.pose_support = None if poses is None else read_pose_support(folder / poses.file)
        self.state_size = self.manifest.state_size
        self.code_size = _code_size(folder.name, self.manifest, self._drapes)
        self.compiled: CompiledNetwork | None = None
        if covered and weights is not None:
            self.compiled = _compiled(folder, weights, network)
        else:
            check_distributions()
        self.nodes_off_provider = 0  # of parts opened so far; on a GPU each waits for a copy
        # Read now: a folder replaced later must not mix its graphs with those of this one.
        files = {name: self.manifest.graphs[name].file for name in graphs}
        self._files = {name: (folder / file).read_bytes() for name, file in files.items()}
        self._weights = {weights.file: (folder / weights.file).read_bytes()} if weights else {}
        self._opened: dict[tuple[Any, ...], Session] = {}
        self._opening = threading.Lock()
        if self.compiled is None:
            self.open_cut(ENCODER, [self._encoded])
            if self.dynamic:
                self.open_cut(DYNAMIC, REQUIRED_OUTPUTS[DYNAMIC])
        self.provider = PROVIDER_NAMES[self._device.provider]

    def check_body(self, body: BodyModel) -> None:
        """Refuses (``ArtifactError``) a body that the model was not trained on."""
        if (body.standard_digest or body.digest) != self.manifest.body_digest:
            raise ArtifactError(
                f"{self.manifest.name} body_digest",
                expected=f"{self.manifest.body_digest} ({self.manifest.body})",
                got=f"{body.digest} ({body.name})",
                cure="Set DRAPE_BODY to the model's body, or export a model for this body.",
            )

    def encode(self, garment: Garment, fabric: Fabric | None = None) -> np.ndarray:
        """Returns the garment encoder's output (K, n) float32 for the K patches of ``garment`` made of ``fabric``, None
        for its own fabric: the input of the drape graph that is computed once for a garment in a fabric."""
        wanted = self.manifest.graphs[ENCODER].inputs[0].shape[-1]
        features = encoder_features(garment, int(wanted), fabric)
        if self.compiled is not None:
            return self.compiled.encode(features)
        return self.open_cut(ENCODER, [self._encoded]).run([self._encoded], {"patch_features": features})[0]

    def advance(self, features: np.ndarray, state: np.ndarray, dt_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the codes (n, C) and the next recurrent states (n, H), float32, of n moving bodies.

        ``features`` (n, 24, 12) are ``motion_features``, ``state`` (n, H) the states before, ``dt_s`` (n,) [s] the
        times since then. Raises ``ArtifactError`` where the network answers with NaN or infinity.
        """
        inputs = {"motion_features": features, "state": state, "dt_s": dt_s}
        feed = {name: np.ascontiguousarray(value, dtype=np.float32) for name, value in inputs.items()}
        if self.compiled is not None:
            code, after = self.compiled.advance(*feed.values())
        else:
            outputs = REQUIRED_OUTPUTS[DYNAMIC]
            code, after = self.open_cut(DYNAMIC, outputs).run(outputs, feed)
        if not (np.isfinite(code).all() and np.isfinite(after).all()):
            raise ArtifactError(
                f"{self.manifest.name} next_state",
                expected="finite numbers",
                got="NaN or infinity",
                cure="Use another model, or motion 0; this one fails on the motion.",
            )
        return code, after

    @property
    def knows_fabrics(self) -> bool:
        """Returns whether the drape depends on what a garment is made of."""
        return bool(self.manifest.network.get("fabric", False))

    @property
    def threads(self) -> int:
        """Returns the number of threads that one call may use."""
        return self._device.threads

    @property
    def feels_body(self) -> bool:
        """Returns whether the network reads posed skin samples, for body proximity."""
        return SKIN in _names(self._drapes.outputs) or "body_skin" in _names(self._drapes.inputs)

    @property
    def pass_count(self) -> int:
        """Returns how many corrections the model has; 0 if all of them always run."""
        outputs = _names(self._drapes.outputs)
        return next(count for count in range(len(outputs) + 1) if pass_name(count + 1) not in outputs)

    def check_passes(self, passes: int | None) -> int | None:
        """Returns ``passes``, or None if that is all of them. Refuses (``InputError``) a number that the model does not
        have."""
        count = self.pass_count
        if passes is not None and not 0 <= passes <= count:
            expected = f"0 to {count}" if count else f"none: the passes of model {self.manifest.name} are fixed"
            raise InputError("advanced.passes", expected=expected, got=str(passes), cure="Leave it out for all passes.")
        return None if passes == count else passes

    def open_cut(
        self,
        graph: str,
        outputs: Sequence[str],
        *,
        direct: Collection[str] = (),
        passes: int | None = None,
        given: Collection[str] = (),
    ) -> Session:
        """Returns the session that computes ``outputs`` of ``graph``, a name in the manifest, and nothing else. It is
        opened at the first call.

        ``direct`` and ``given`` are those of ``subgraph.cut``. ``passes`` corrections of the packed graph run, None for
        all. A model that runs by its readable graph (``whole``) gets a session of the whole graph.
        """
        passes = self.check_passes(passes)
        key = graph, tuple(outputs), tuple(direct), passes, tuple(given)
        if key not in self._opened:
            with self._opening:
                if key not in self._opened:
                    self._opened[key] = self._open(graph, outputs, direct, passes, given)
        return self._opened[key]

    def _open(
        self, graph: str, outputs: Sequence[str], direct: Collection[str], passes: int | None, given: Collection[str]
    ) -> Session:
        name, spec = self.manifest.name, self.manifest.graphs[graph]
        instead = None if passes is None else {pass_name(self.pass_count): pass_name(passes)}
        model = self._files[graph]
        if not self.whole:
            model = cut(model, outputs, direct=direct, instead=instead, given=given)
        # Operations of the push-outs are too small to be shared: two threads take longer than one.
        device = replace(self._device, threads=1) if graph in PUSHES else self._device
        session = open_session(f"{name}/{spec.file}", model, self._weights, device)
        self.nodes_off_provider += nodes_off_provider(session, device)
        types = {t.name: t.type for t in session.get_inputs()}
        tensors = (*spec.inputs, *(t for t in spec.outputs if t.name in given))
        _compare(name, graph, "inputs", {t.name: t.dtype for t in tensors if t.name in types}, types)
        types = {t.name: t.type for t in session.get_outputs()}
        _compare(name, graph, "outputs", {t.name: t.dtype for t in spec.outputs if t.name in types}, types)
        return Session(session, device)

    def value(self, array: np.ndarray) -> onnxruntime.OrtValue:
        """Returns ``array`` as a value of ONNX Runtime on the device of the graphs; on a CPU both share their
        memory."""
        return self._device.value(array)


def _compiled(folder: Path, weights: WeightsSpec, network: Mapping[str, Any]) -> CompiledNetwork:
    try:
        return CompiledNetwork(read_parameters(folder, weights), network)
    except (KeyError, ValueError) as error:
        expected = "those of the network that it describes"
        raise misexported(f"{folder.name} parameters", expected=expected, got=str(error)) from error


def _names(tensors: Sequence[TensorSpec]) -> set[str]:
    return {tensor.name for tensor in tensors}


def _check_graphs(model: str, manifest: Manifest, run: Sequence[str], *, encoded: str) -> None:
    """Refuses a model that lacks a graph of ``run``, and a graph that lacks an output which is read."""
    for name in run:
        spec = manifest.graphs.get(name)
        if spec is None:
            raise misexported(f"{model} graphs", expected=f"a graph {name!r}", got=str(sorted(manifest.graphs)))
        missing = {encoded} if name == ENCODER else set(REQUIRED_OUTPUTS[name])
        missing -= _names(spec.outputs)
        if missing:
            raise misexported(f"{model} {name} outputs", expected=", ".join(sorted(missing)), got="none")


def _code_size(model: str, manifest: Manifest, drapes: GraphSpec) -> int:
    """The length of a dynamic code, 0 for a static model. Refuses graphs that are not what the manifest says."""
    code = {t.name: t.shape[-1] for t in drapes.inputs}.get("dynamic_code", 0)
    states = [t.shape[-1] for t in manifest.graphs[DYNAMIC].inputs if t.name == "state"] if manifest.dynamic else [0]
    fits = (code != 0) == manifest.dynamic and states == [manifest.state_size]
    if not fits or not isinstance(code, int):
        raise misexported(
            f"{model} dynamic",
            expected="a packed graph with a dynamic_code and a state of state_size, or neither",
            got=f"dynamic {manifest.dynamic}, dynamic_code of {code}, states {states} and {manifest.state_size}",
        )
    return code


def _compare(model: str, graph: str, side: str, written: dict[str, str], types: dict[str, str]) -> None:
    if set(written) != set(types):
        raise misexported(
            f"{model} {graph} {side}", expected=f"{sorted(written)} as in the manifest", got=str(sorted(types))
        )
    for name, dtype in written.items():
        if _TYPES.get(dtype) != types[name]:
            raise misexported(f"{model} {graph} {name}", expected=f"{dtype} as in the manifest", got=types[name])
