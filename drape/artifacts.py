"""The model folder: ONNX files, the weights they share, and ``manifest.json``; one dataclass writes and reads it."""

from __future__ import annotations

import hashlib
import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drape.errors import ArtifactError, NotFound
from drape.folders import ASSETS

FORMAT_VERSION = 1
MODELS_DIR = ASSETS / "models"
DEFAULT_MODEL = "onefit"


@dataclass(frozen=True)
class TensorSpec:
    """One input or output tensor of a graph. ``shape`` has the length of each axis, or a name where the length is free.
    ``dtype`` is NumPy's name of the type, ``unit`` that of the numbers, empty where it is not told."""

    name: str
    shape: tuple[str | int, ...]
    dtype: str
    unit: str = ""

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> TensorSpec:
        return cls(data["name"], tuple(data["shape"]), data["dtype"], data.get("unit", ""))


@dataclass(frozen=True)
class GraphSpec:
    """One ONNX file of a model: its name in the model's folder, its sha256 (hexadecimal), its opset and its tensors."""

    file: str
    sha256: str
    opset: int
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]


@dataclass(frozen=True)
class ParameterSpec:
    """Where a parameter of the network lies in the file of weights: float32 of ``shape``, from byte ``offset`` on.

    A ``turned`` matrix is stored transposed, as the graphs multiply with it; ``shape`` is that of the parameter itself.
    """

    offset: int
    shape: tuple[int, ...]
    turned: bool = False

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> ParameterSpec:
        return cls(data["offset"], tuple(data["shape"]), data["turned"])


@dataclass(frozen=True)
class WeightsSpec:
    """The file of the tensors that lie outside the ONNX files (ONNX external data): its name in the model's folder, its
    sha256 (hexadecimal), and where in it the network's ``parameters`` lie, by their names in training."""

    file: str
    sha256: str
    parameters: dict[str, ParameterSpec] = field(default_factory=dict)


@dataclass(frozen=True)
class FileSpec:
    """A file of the model's folder beside the graphs: its name and its sha256 (hexadecimal)."""

    file: str
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """The record ``manifest.json`` of a model folder.

    ``graphs``: by name "garment_encoder" (patch features -> embedding, run once per garment) and "drape" (pose +
    garment -> vertices); of a ``dynamic`` model also "dynamic_encoder" (motion + state -> what the drape graph adds to
    the pose, next state), with a state of ``state_size`` numbers per client. ``embedding_size``: numbers of a patch's
    embedding. ``body``, ``body_digest``: name and sha256 of the body the network was trained on. ``parity_error_m``:
    largest vertex distance torch vs onnxruntime at export. ``quality``: rows of the record of ``benchmarks.quality``,
    empty where it was not measured. ``training``: facts such as "commit", "command" and "frames", the number of frames
    seen. ``network``: the fields of ``training.config.ModelConfig`` by name. ``weights``: None where every graph holds
    its own. ``tiers``: fields of ``drape.stages.tiers.Tier`` by name, the least tier first. ``poses``: the file of
    ``drape.body.pose_distance``, None where none was made.
    """

    name: str
    graphs: dict[str, GraphSpec]
    body: str
    body_digest: str
    embedding_size: int
    parity_error_m: float
    dynamic: bool = False
    state_size: int = 0
    training: dict[str, Any] = field(default_factory=dict)
    quality: list[dict[str, Any]] = field(default_factory=list)
    network: dict[str, Any] = field(default_factory=dict)
    weights: WeightsSpec | None = None
    tiers: list[dict[str, Any]] = field(default_factory=list)
    poses: FileSpec | None = None
    format_version: int = FORMAT_VERSION

    @property
    def digest(self) -> str:
        """The sha256 (hexadecimal) of the hashes of all graphs and of the file of weights: the key of whatever is
        computed with the model."""
        joined = "".join(f"{key}{self.graphs[key].sha256}" for key in sorted(self.graphs))
        if self.weights is not None:  # Two trainings of one network differ here alone.
            joined += f"weights{self.weights.sha256}"
        return hashlib.sha256(joined.encode()).hexdigest()

    def to_json(self) -> str:
        return json.dumps(asdict(self), indent=1) + "\n"

    @classmethod
    def from_json(cls, text: str, *, where: str) -> Manifest:
        try:
            data = json.loads(text)
            version = data.get("format_version")
            if version != FORMAT_VERSION:
                raise _refused(f"{where} format_version", str(FORMAT_VERSION), version)
            data["graphs"] = {
                key: GraphSpec(
                    file=spec["file"],
                    sha256=spec["sha256"],
                    opset=spec["opset"],
                    inputs=tuple(TensorSpec.from_json(t) for t in spec["inputs"]),
                    outputs=tuple(TensorSpec.from_json(t) for t in spec["outputs"]),
                )
                for key, spec in data["graphs"].items()
            }
            if data.get("weights") is not None:
                weights = data["weights"]
                places = {key: ParameterSpec.from_json(place) for key, place in weights.get("parameters", {}).items()}
                data["weights"] = WeightsSpec(weights["file"], weights["sha256"], places)
            if data.get("poses") is not None:
                data["poses"] = FileSpec(**data["poses"])
            return cls(**data)
        except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
            raise _refused(where, "a model manifest", error) from error


def _refused(name: str, expected: str, got: object) -> ArtifactError:
    return ArtifactError(name, expected=expected, got=str(got), cure="Export the model again.")


def read_parameters(folder: Path, weights: WeightsSpec) -> dict[str, np.ndarray]:
    """Returns the parameters of the network in the model ``folder``: float32 arrays by their names in training.
    ``weights`` is the entry of the model's manifest."""
    content = (folder / weights.file).read_bytes()

    def read(place: ParameterSpec) -> np.ndarray:
        shape = place.shape[::-1] if place.turned else place.shape
        values = np.frombuffer(content, np.float32, count=math.prod(shape), offset=place.offset).reshape(shape)
        return np.array(values.T if place.turned else values, order="C")

    return {name: read(place) for name, place in weights.parameters.items()}


def file_digest(path: Path) -> str:
    """Returns the sha256 of a file, hexadecimal."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def model_folder(name: str | Path) -> Path:
    """Returns the folder of the model ``name``: ``name`` itself where it is a folder with a manifest, otherwise the
    folder of that name in ``MODELS_DIR``, which need not exist."""
    return Path(name) if (Path(name) / "manifest.json").is_file() else MODELS_DIR / name


def load_manifest(folder: Path) -> Manifest:
    """Returns the manifest of the model in ``folder``.

    Raises ``NotFound`` where there is none, and ``ArtifactError`` where it cannot be read or a file that it names is
    missing or has changed.
    """
    path = folder / "manifest.json"
    if not path.is_file():
        known = sorted(p.parent.name for p in folder.parent.glob("*/manifest.json"))
        raise NotFound(
            "model",
            expected=f"one of {known} in {folder.parent.name}/",
            got=folder.name,
            cure="Check the name, or export a model there.",
        )
    manifest = Manifest.from_json(
        path.read_text(encoding="utf-8", errors="replace"), where=f"{folder.name}/manifest.json"
    )
    files: dict[str, GraphSpec | WeightsSpec | FileSpec] = {**manifest.graphs}
    if manifest.poses is not None:
        files["poses"] = manifest.poses
    if manifest.weights is not None:
        files["weights"] = manifest.weights
    for key, spec in files.items():
        file = folder / spec.file
        if not file.is_file():
            raise _refused(f"{folder.name} {key}", spec.file, "no such file")
        digest = file_digest(file)
        if digest != spec.sha256:
            raise ArtifactError(
                f"{folder.name}/{spec.file} sha256",
                expected=spec.sha256,
                got=digest,
                cure="Restore the file or export again.",
            )
    return manifest


@contextmanager
def staged_folder(target: Path) -> Iterator[Path]:
    """Yields a new empty folder to write in. It takes the place of ``target`` when the block ends, and is removed when
    the block raises."""
    target.parent.mkdir(parents=True, exist_ok=True)
    staged = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    try:
        yield staged
        staged.chmod(0o755)  # mkdtemp makes folders that only the owner can read.
        publish_folder(staged, target)
    except BaseException:
        shutil.rmtree(staged, ignore_errors=True)
        raise


def publish_folder(staged: Path, target: Path) -> None:
    """Moves the finished folder ``staged`` to ``target``, in the place of what was there.

    A crash leaves the old folder (perhaps under ``NAME.old``) or the new one, never a mixture.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    retired = target.with_name(target.name + ".old")
    if target.exists():
        if retired.exists():
            shutil.rmtree(retired)
        os.replace(target, retired)
    os.replace(staged, target)
    if retired.exists():
        shutil.rmtree(retired)
