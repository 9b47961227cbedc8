"""The packed drape graph: any mix of garments, clients and frames in one call, and nothing computed twice.

It computes the same as ``body_feed`` and the readable ``DrapeGraph``, arranged for speed; the two are compared in
``model_export.parity``.

- Patches of all items lie one after the other. ``patch_body`` names the body of each, ``patch_stored`` its row among
  the constants of the garments in store, which are handed over once.
- The garment half of the decoder's first layer is a constant of the garment (``patch_first``).
- A body comes as 24 quaternions and rest joints; its bones and features are a few small products here, and some
  three hundred calls in numpy.
- Network and frame give the posed jets, a 3 x 18 matrix per patch. A vertex is the sum over its four charts of
  such a matrix times a constant column, so charts are sorted by patch into tiles of ``CHARTS_PER_TILE`` columns:
  the vertex stage is one small product of a fixed shape per tile and a sum of four rows.
- Outputs are independent branches: the service cuts the graph of a scene out of this one. The jets after each pass are
  outputs too: a cut that reads those of an early pass in place of the last one's runs no later pass.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn

from drape.artifacts import GraphSpec, TensorSpec
from drape.body.skeleton import JOINT_COUNT
from drape.contact.samples import REGION_SIZE
from drape.errors import ArtifactError
from drape.garment.patch_features import JOINT_REACH_M
from drape.geometry import jets
from drape.graph.inputs import ROOT, SLOPE
from drape.graph.packed_inputs import VERTICES_PER_BLOCK, Indices, PackedBodies, PackedTensors, StoredPatches
from drape.graph.packing import pass_name
from model_export.onnx_file import write_graph
from model_export.packed.chart_tiles import ChartConsensus
from model_export.packed.kinematics import PatchFrames, PatchKinematics
from model_export.packed.operators import TRANSLATIONS, rows
from model_export.packed.skin_planes import Contact, posed_skins
from model_export.packed.strain import Strain
from training.onefit import OneFit

SKIN_OUTPUT = TensorSpec(
    "skin", ("bodies", "regions", REGION_SIZE, 8), "float32", "m and 1, relative to the root joint"
)


def packed_inputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Inputs of the packed graph of ``model``, in order."""
    return PackedTensors.specs(model.config.parts, **model.config.axes)


def packed_outputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Outputs of the packed graph of ``model``, in order."""
    passes = model.config.corrections + 1 if model.config.corrections else 0
    return (
        TensorSpec("vertices", ("blocks", VERTICES_PER_BLOCK, 3), "float32", ROOT),
        TensorSpec("jet", ("patches", model.jet_count), "float32", "patch scales"),
        TensorSpec("frame_rotation", ("patches", 3, 3), "float32", "1"),
        TensorSpec("frame_centre", ("patches", 3), "float32", ROOT),
        SKIN_OUTPUT,
        # Jets before the first correction and after each.
        *(TensorSpec(pass_name(i), ("patches", jets.JET_COUNT), "float32", "patch scales") for i in range(passes)),
    )


def first_outputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Outputs of the garment encoder where the model has a packed graph."""
    return (
        TensorSpec("patch_embedding", ("patches", model.config.embedding_size), "float32", "1"),
        TensorSpec("patch_first", ("patches", model.config.decoder_sizes[0]), "float32", "1"),
    )


def write_packed(model: OneFit, path: Path) -> GraphSpec:
    """Writes the packed graph of ``model`` as the ONNX file ``path``; returns its entry in the manifest.

    Raises ``ArtifactError`` for a network of variant "paper".
    """
    graph = PackedGraph(model).eval()
    return write_graph(graph, path, packed_inputs(model), packed_outputs(model), translations=TRANSLATIONS)


@dataclass(frozen=True)
class PosedPatches:
    """P posed patches: ``coefficients`` (P, 3, 18) as ``ChartConsensus.posed`` returns them, and ``jet`` (P, 45)
    [patch scales], the change of the full rest jets in ``frames``.

    ``skin`` (B, R, 12, 8) are the posed samples of the bodies' skin. ``passes`` are the jets (P, 27) before the first
    correction and after each, () for a network without corrections.
    """

    coefficients: Tensor
    jet: Tensor
    frames: PatchFrames
    skin: Tensor
    passes: tuple[Tensor, ...]


class FirstGraph(nn.Module):
    """The module of the graph that runs once per garment: from the features (K, D) of its patches it computes their
    embedding (K, E) and, from that, the garment's share (K, W) of the decoder's first layer."""

    def __init__(self, model: OneFit) -> None:
        super().__init__()
        self.garment, self.from_patch = model.garment, model.decoder.from_patch

    def forward(self, tensors: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        embedding = self.garment(tensors["patch_features"])
        return embedding, self.from_patch(embedding)


class PackedGraph(nn.Module):
    """The module of the packed graph: it takes ``drape.graph.packed_inputs.PackedTensors`` by name, and returns the
    tensors of ``packed_outputs`` in order.

    Raises ``ArtifactError`` for a network of variant "paper", whose vertices are skinned.
    """

    axis_sums: Tensor

    def __init__(self, model: OneFit) -> None:
        super().__init__()
        if not model.config.vector:
            raise ArtifactError(
                "variant",
                expected="'vector'",
                got=repr(model.config.variant),
                cure="Only vector jets are packed; serve this model with its drape graph.",
            )
        decoder = model.decoder
        assert decoder.from_surroundings is not None
        self.body = model.body
        self.from_body = decoder.from_body
        self.trunk = decoder.trunk
        self.from_surroundings = surroundings_layer(decoder.from_surroundings)
        self.head = merged_heads(decoder.heads, model.config.output_gain)
        self.kinematics, self.charts = PatchKinematics(), ChartConsensus()
        self.strain, self.contact = Strain(), Contact()
        self.corrections = nn.ModuleList(
            correction_layers(correction, model.config.output_gain) for correction in model.corrections
        )
        self.register_buffer("axis_sums", torch.eye(JOINT_COUNT).repeat(3, 1))

    def forward(self, tensors: dict[str, Tensor]) -> tuple[Tensor, ...]:
        inputs = PackedTensors.from_flat(tensors)
        index, tiles = inputs.index, inputs.tiles
        posed = self.pose(inputs.bodies, inputs.patches.each(lambda table: rows(table, index.stored)), index)
        coefficients = rows(posed.coefficients, index.tile_patch)  # (Q, 3, 18)
        vertices = self.charts.blend(coefficients, rows(tiles.positions, index.tile_stored), index.vertex_charts)
        return (
            vertices, posed.jet, posed.frames.rotation, posed.frames.centre.reshape(-1, 3),
            posed.skin, *posed.passes,
        )  # fmt: skip

    def pose(self, bodies: PackedBodies, patches: StoredPatches, index: Indices) -> PosedPatches:
        """Returns ``patches`` posed on ``bodies``. ``patches`` are those of all items of the call, one after the other;
        ``index`` says on which of the ``bodies`` each is."""
        bones, features = self.kinematics(bodies)
        code = self.body(features)
        if bodies.dynamic_code is not None:
            code = code + bodies.dynamic_code
        frames = self.kinematics.frames(bodies, bones, patches, index)
        charts, stored, felt = self.charts, patches.charts, patches.proximity
        assert stored is not None and felt is not None and bodies.skins is not None
        base = charts.agreed(frames.out @ stored.columns[:, :4], stored, index, frames)
        x = patches.first + rows(self.from_body(code), index.body)
        x = self._with_surroundings(x, rows(bones.joints.mT, index.body), frames, base)
        hidden = self.trunk(nn.functional.leaky_relu(x, SLOPE))
        jet = base + self.head(hidden)
        passes, columns = [jet], charts.columns(stored.columns)
        skin = posed_skins(bodies.skins, bones.rotation, bones.translation)
        near = stretch = places = None
        for correction in self.corrections:
            jet = charts.agreed(charts.posed(frames, jet) @ columns, stored, index, frames)
            stretch = self.strain.stretch(stored.tangent, stored.unit) if stretch is None else stretch
            places = self.contact.places(felt) if places is None else places
            points = self.contact.points(jet, places)
            near = self.contact.near(points, skin, felt, index.body, frames) if near is None else near
            inputs = [hidden, *self.strain(jet, stretch), jet, *self.contact(points, near)]
            change = correction(torch.cat(inputs, dim=-1))
            jet = jet + self.contact.held(points, self.contact.points(jet + change, places), near) * change
            passes.append(jet)
        jet = charts.closed(charts.posed(frames, jet) @ columns, stored, index, frames)
        return PosedPatches(charts.posed(frames, jet), jet, frames, skin, tuple(passes) if self.corrections else ())

    def _with_surroundings(self, x: Tensor, joints: Tensor, frames: PatchFrames, base: Tensor) -> Tensor:
        """``x`` plus the layer on ``patch_surroundings`` of posed joints (P, 3, 24), and on ``base``."""
        offset = frames.rotation.mT @ (joints - frames.centre)
        # A maximum and not a sum: the exporter's optimiser takes "+ 1e-12" for "+ 0" and drops the guard.
        squared = ((offset * offset).reshape(-1, 3 * JOINT_COUNT) @ self.axis_sums).reshape(-1, 1, JOINT_COUNT)
        reach = torch.sqrt(torch.clamp(squared, min=1e-12))
        saturated = (offset * (torch.tanh(reach * (1.0 / JOINT_REACH_M)) / reach)).reshape(-1, 3 * JOINT_COUNT)
        seen = torch.cat([saturated, frames.rotation.reshape(-1, 9), base], dim=-1)
        return torch.addmm(x, seen, self.from_surroundings)


def surroundings_layer(layer: nn.Linear) -> nn.Parameter:
    """Returns the weights (108, n) of ``layer`` for the inputs of the packed graph: the joints' offsets as (3, 24), the
    patch's rotation (9) and the jets (27) with which rigid patches fit their blend. ``layer`` itself takes the offsets
    as (24, 3), gravity (3) and these jets."""
    count = 3 * JOINT_COUNT
    weight = layer.weight.detach()
    base = weight[:, count + 3 :].T
    matrix = torch.zeros(count + 9 + len(base), layer.out_features)
    matrix[count + 9 :] = base
    matrix[:count] = weight[:, :count].reshape(-1, JOINT_COUNT, 3).permute(2, 1, 0).reshape(count, -1)
    matrix[count + 3 : count + 6] = -weight[:, count : count + 3].T  # gravity is minus the second row of the rotation
    return nn.Parameter(matrix, requires_grad=False)


def merged_heads(heads: nn.ModuleDict, gain: float) -> nn.Sequential:
    """Returns the heads "plane" and "height" as one network, from the trunk's output to jets (P, 27) [patch scales].
    The output ``gain`` is in its weights."""
    plane, height = _linears(heads["plane"]), _linears(heads["height"])
    layers: list[nn.Module] = []
    for depth, (a, b) in enumerate(zip(plane[:-1], height[:-1], strict=True)):
        layer = _side_by_side(a, b, shared=depth == 0)  # both read the trunk's output
        layers += [layer, nn.LeakyReLU(SLOPE)]
    last = _side_by_side(plane[-1], height[-1], shared=len(plane) == 1)
    with torch.no_grad():
        last.weight.mul_(gain)
        last.bias.mul_(gain)
    return nn.Sequential(*layers, last).requires_grad_(False)


def correction_layers(correction: nn.Module, gain: float) -> nn.Sequential:
    """Returns a copy of ``correction``, a ``training.layers.Correction``, with the output ``gain`` in its weights."""
    first, last = _linears(correction)
    scaled = nn.Linear(last.in_features, last.out_features)
    with torch.no_grad():
        scaled.weight.copy_(gain * last.weight)
        scaled.bias.copy_(gain * last.bias)
    return nn.Sequential(copy.deepcopy(first), nn.LeakyReLU(SLOPE), scaled).requires_grad_(False)


def _linears(head: nn.Module) -> list[nn.Linear]:
    return [cast(nn.Linear, child) for child in head.children() if isinstance(child, nn.Linear)]


def _side_by_side(a: nn.Linear, b: nn.Linear, *, shared: bool) -> nn.Linear:
    """One layer with the outputs of both, which read the same input if it is ``shared``, else one each."""
    start = 0 if shared else a.in_features
    layer = nn.Linear(start + b.in_features, a.out_features + b.out_features)
    with torch.no_grad():
        layer.weight.zero_()
        layer.weight[: a.out_features, : a.in_features] = a.weight
        layer.weight[a.out_features :, start:] = b.weight
        layer.bias[: a.out_features], layer.bias[a.out_features :] = a.bias, b.bias
    return layer
