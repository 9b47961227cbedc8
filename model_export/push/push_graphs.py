"""The push-out as graphs of their own: draped vertices and bones in, vertices out of the body, or of garments below.

They have no weights: skin, garments and clearance are inputs, so one file serves every network, garment, body and
shape, and takes what the drape graph gives, what the packed graph gives, and plain skinning where a network fails.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor, nn

from drape.arrays import Array
from drape.arrays.tensors import Tensors, group, tensor
from drape.artifacts import GraphSpec, TensorSpec, file_digest
from drape.body.skeleton import JOINT_COUNT
from drape.contact.projection import TERMS, Pushed, PushFeed, push_in_parts
from drape.contact.samples import REGION_SIZE
from drape.contact.skin import SkinOnBones, skin_table
from drape.graph.layer_feed import LayerFeed, push_over_in_parts
from model_export.onnx_file import OPSET, write_graph
from model_export.packed.operators import TRANSLATIONS

OUTPUTS: tuple[TensorSpec, ...] = (
    TensorSpec("pushed", ("frames", "vertices", 3), "float32", "m"),
    TensorSpec("jet_push", ("frames", "patches", 3, TERMS), "float32", "m, in the axes of the vertices"),
    TensorSpec("left", ("frames",), "float32", "m, what the jets lack"),
    TensorSpec("skin", ("frames", "regions", REGION_SIZE, 8), "float32", "m and 1, as the bones"),
)


@dataclass(frozen=True, eq=False)
class Drapes(Tensors):
    """F drapes of V vertices over posed bodies, in one frame of coordinates: vertices, transforms of the bones,
    clearance, and the constants of the body's skin."""

    vertices: Array = tensor("vertices", "frames", "vertices", 3, unit="m")
    rotation: Array = tensor("bone_rotation", "frames", JOINT_COUNT, 3, 3)
    translation: Array = tensor("bone_translation", "frames", JOINT_COUNT, 3, unit="m, relative as vertices are")
    clearance: Array = tensor("clearance", 1, unit="m")
    skin: SkinOnBones = group(SkinOnBones)

    def samples(self) -> Array:
        """Returns the posed samples (F, R, 12, 8) of the skin as ``drape.contact.samples.sample_table`` has them."""
        return skin_table(self.skin.rows, self.skin.bones, self.rotation, self.translation)


@dataclass(frozen=True, eq=False)
class PushTensors(Drapes):
    """Inputs of the push-out: drapes, and the constants ``feed`` of their garment."""

    feed: PushFeed = group(PushFeed)


@dataclass(frozen=True, eq=False)
class LayerTensors(Drapes):
    """Inputs of the push-out of a garment over others: its drapes and constants, and the vertices ``under`` of the
    others' drapes."""

    feed: LayerFeed = group(LayerFeed)
    under: Array = tensor("under", "frames", "under_vertices", 3, unit="m")


class PushGraph(nn.Module):
    """The module of ``drape.contact.projection.push_out`` as a graph: it takes ``PushTensors`` by name, and returns the
    tensors of ``OUTPUTS``."""

    inputs = PushTensors.specs()

    def forward(self, tensors: dict[str, Tensor]) -> tuple[Tensor, ...]:
        drapes = PushTensors.from_flat(tensors)
        skin = drapes.samples()
        return *_parts(push_in_parts(drapes.vertices, skin, drapes.feed, drapes.clearance)), skin


class LayerGraph(nn.Module):
    """The module of ``drape.graph.layer_feed.push_over`` as a graph: it takes ``LayerTensors`` by name, and returns the
    tensors of ``OUTPUTS``."""

    inputs = LayerTensors.specs()

    def forward(self, tensors: dict[str, Tensor]) -> tuple[Tensor, ...]:
        drapes = LayerTensors.from_flat(tensors)
        skin = drapes.samples()
        pushed = push_over_in_parts(drapes.vertices, drapes.under, skin, drapes.feed, drapes.clearance)
        return *_parts(pushed), skin


def _parts(pushed: Pushed) -> tuple[Tensor, Tensor, Tensor]:
    return pushed.vertices, pushed.coefficients, pushed.left_m


PUSHES: dict[str, Callable[[], PushGraph | LayerGraph]] = {"push_out": PushGraph, "push_over": LayerGraph}


def write_push(name: str, folder: Path) -> GraphSpec:
    """Copies the graph ``name`` of ``PUSHES``, which was traced once for all models, to ``NAME.onnx`` in ``folder``.
    Returns its entry in the manifest."""
    path = folder / f"{name}.onnx"
    path.write_bytes(graph_path(name).read_bytes())
    return GraphSpec(path.name, file_digest(path), OPSET, PUSHES[name].inputs, OUTPUTS)


def graph_path(name: str) -> Path:
    """Returns the path of the traced graph ``name`` beside this file. Every export compares it with the reference in
    NumPy."""
    return Path(__file__).with_name(f"{name}.onnx")


def trace_graph(name: str) -> bytes:
    """Returns the content of the ONNX file of the graph ``name``, traced anew, which takes half a minute."""
    graph = PUSHES[name]()
    with tempfile.TemporaryDirectory(prefix="push-out-") as folder:
        path = Path(folder) / "push.onnx"
        write_graph(graph, path, graph.inputs, OUTPUTS, translations=TRANSLATIONS)
        return path.read_bytes()
