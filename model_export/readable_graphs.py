"""The graphs to read: the garment encoder, the drape of a pose, and what motion adds to it.

Each takes its inputs as one dictionary by name, as an ONNX session does; what they are is declared in
``drape.graph.inputs``.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from drape.arrays import Array
from drape.arrays.tensors import Tensors, group, tensor
from drape.artifacts import TensorSpec
from drape.body.skeleton import JOINT_COUNT
from drape.graph.inputs import AGREES, DYNAMIC, PAPER, ROOT, BodyTensors, ChartTensors, MotionTensors, PatchTensors
from training.chart_consensus import GatheredConsensus
from training.onefit import OneFit, paper_vertices, vertex_positions


@dataclass(frozen=True, eq=False)
class DrapeTensors(Tensors):
    """All inputs of the drape graph."""

    body: BodyTensors = group(BodyTensors)
    embedding: Array = tensor("patch_embedding", "patches", "embedding")
    patches: PatchTensors = group(PatchTensors)
    charts: ChartTensors = group(ChartTensors)
    skin_weights: Array | None = tensor("skin_weights", "vertices", JOINT_COUNT, part=PAPER)
    dynamic_code: Array | None = tensor(
        "dynamic_code", "frames", "code", unit="1, scaled by the motion knob", part=DYNAMIC
    )
    consensus: GatheredConsensus | None = group(GatheredConsensus, part=AGREES)


def drape_inputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Inputs of the drape graph of ``model``, in order."""
    return DrapeTensors.specs(model.config.parts, **model.config.axes)


def drape_outputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Outputs of the drape graph of ``model``, in order."""
    return (
        TensorSpec("vertices", ("frames", "vertices", 3), "float32", ROOT),
        TensorSpec("jet", ("frames", "patches", model.jet_count), "float32", "patch scales"),
        TensorSpec("frame_rotation", ("frames", "patches", 3, 3), "float32", "1"),
        TensorSpec("frame_centre", ("frames", "patches", 3), "float32", ROOT),
    )


def dynamic_inputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Inputs of the dynamic encoder graph of a dynamic ``model``."""
    return MotionTensors.specs(model.config.parts, **model.config.axes)


def dynamic_outputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Outputs of the dynamic encoder graph."""
    return (
        TensorSpec("dynamic_code", ("clients", model.config.body_code_size), "float32", "1"),
        TensorSpec("next_state", ("clients", model.config.state_size), "float32", "1"),
    )


def encoder_inputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Inputs of the garment encoder graph."""
    return (TensorSpec("patch_features", ("patches", model.config.encoder_feature_count), "float32", "1"),)


def encoder_outputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Outputs of the garment encoder graph where the model has no packed graph; otherwise they are
    ``first_outputs``."""
    return (TensorSpec("patch_embedding", ("patches", model.config.embedding_size), "float32", "1"),)


class EncoderGraph(nn.Module):
    """The module of the graph that runs once per garment: it computes the embeddings (K, E) of patches from their
    features (K, D)."""

    def __init__(self, model: OneFit) -> None:
        super().__init__()
        self.garment = model.garment

    def forward(self, tensors: dict[str, Tensor]) -> Tensor:
        return self.garment(tensors["patch_features"])


class DynamicGraph(nn.Module):
    """The module of the graph that runs once per frame: from the motion features, the state and the time step of each
    client it computes the code that is added to that of its pose, and its next state."""

    def __init__(self, model: OneFit) -> None:
        super().__init__()
        assert model.dynamic is not None
        self.dynamic = model.dynamic

    def forward(self, tensors: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        motion = MotionTensors.from_flat(tensors)
        return self.dynamic(motion.features, motion.state, motion.dt_s)


class DrapeGraph(nn.Module):
    """The module of the drape graph: it takes ``DrapeTensors`` by name, and returns the tensors of ``drape_outputs``:
    vertices, changes of the rest jets, and the rotations and centres of the posed frames."""

    def __init__(self, model: OneFit) -> None:
        super().__init__()
        self.model = model

    def forward(self, tensors: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        inputs = DrapeTensors.from_flat(tensors)
        posed = self.model(inputs.body, inputs.patches, inputs.embedding, inputs.dynamic_code, charts=inputs.consensus)
        vertices = vertex_positions(posed, inputs.patches, inputs.charts)
        if inputs.skin_weights is not None:
            vertices = paper_vertices(vertices, inputs.skin_weights, inputs.body)
        return vertices, posed.jet, posed.rotation + torch.zeros_like(posed.centre[..., None]), posed.centre
