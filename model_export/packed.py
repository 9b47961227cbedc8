"""The packed drape graph: any mix of garments, clients and frames in one call, and nothing computed twice.

What ``body_feed`` and the readable ``DrapeGraph`` compute, arranged for speed; ``packed_parity`` compares the two.

- Patches of all items lie one after the other. ``patch_body`` names the body of each, ``patch_stored`` its row among
  the constants of the garments in store, which are handed over once.
- The garment half of the decoder's first layer is a constant of the garment (``patch_first``).
- A body comes as 24 quaternions and rest joints; its bones and features are a few small products here, and some
  three hundred calls in numpy.
- Network and frame give the posed jets, a 3 x 18 matrix per patch. A vertex is the sum over its four charts of
  such a matrix times a constant column, so charts are sorted by patch into tiles of ``CHARTS_PER_TILE`` columns:
  the vertex stage is one small product of a fixed shape per tile and a sum of four rows.
- Outputs are independent branches: ``service.subgraph`` cuts the graph of a scene out of this one. The jets after each
  pass are outputs too: with those of an early pass in place of the last one's, what is cut out ends there.
"""

from __future__ import annotations

from typing import Any

import onnxscript
import torch
from torch import Tensor, nn

from drape.body.features import STATIC_PER_JOINT
from drape.body.skeleton import JOINT_COUNT
from drape.errors import ArtifactError
from drape.garment.agreement import FIT_COUNT, MEMBERS
from drape.garment.cache import CHARTS_PER_VERTEX
from drape.garment.features import REACH_M
from drape.geometry import jets
from drape.graph.packing import CHARTS_PER_TILE, COLUMNS, VERTICES_PER_BLOCK
from drape.wire.messages import STEP_COUNT
from model_export import packed_weights as constants
from model_export.packed_contact import Contact, Felt, Skins, posed_skins
from model_export.packed_parts import Bodies, Charts, Patches, PosedPatches
from model_export.packed_strain import Strain
from training.layers import SLOPE
from training.model import OneFit


def _gather(table, dim, index):
    """``torch.index_select`` as one Gather; the exporter's own adds a Reshape and a Cast to every index.

    Columns of a matrix with few rows as GatherElements, which walks a row at once: 4.5 times as fast on a processor.
    """
    op: Any = onnxscript.opset20
    if dim != 1 or len(table.shape) != 2:
        return op.Gather(table, index, axis=dim)
    if isinstance(table.shape[0], int):
        shape = op.Constant(value_ints=[table.shape[0], 1])
    else:
        shape = op.Concat(op.Shape(table, start=0, end=1), op.Constant(value_ints=[1]), axis=0)
    return op.GatherElements(table, op.Expand(index, shape), axis=1)


def _softsign(x):
    return onnxscript.opset20.Softsign(x)


TRANSLATIONS = {torch.ops.aten.index_select.default: _gather, torch.ops.drape.softsign.default: _softsign}


class FirstGraph(nn.Module):
    """Patch features -> patch embedding, and the garment half of the decoder's first layer; run once per garment."""

    def __init__(self, model: OneFit) -> None:
        super().__init__()
        self.garment, self.from_patch = model.garment, model.decoder.from_patch

    def forward(self, patch_features: Tensor) -> tuple[Tensor, Tensor]:
        embedding = self.garment(patch_features)
        return embedding, self.from_patch(embedding)


class PackedGraph(nn.Module):
    """Bodies, stored garments and index tensors of ``drape.graph.packing`` -> all of ``packed_specs.packed_outputs``.

    Only for vector jets: the paper's variant skins vertices, which is another vertex stage.
    """

    rotation_terms: Tensor
    sixd_terms: Tensor
    neutral: Tensor
    left_terms: Tensor
    cross_terms: Tensor
    identity: Tensor
    offsets: Tensor
    descent: Tensor
    parents: Tensor
    without_root: Tensor
    placed: Tensor
    placed_full: Tensor
    frame_only: Tensor
    fit_choice: Tensor
    full_choice: Tensor
    chart_sums: Tensor
    axis_sums: Tensor
    higher_first: Tensor
    higher_second: Tensor

    def __init__(self, model: OneFit) -> None:
        super().__init__()
        if model.config.variant != "vector":
            raise ArtifactError(
                "variant",
                expected="'vector'",
                got=repr(model.config.variant),
                cure="Only vector jets are packed; serve this model with its drape graph.",
            )
        decoder = model.decoder
        self.body = model.body
        self.from_body = decoder.from_body
        self.trunk = decoder.trunk
        self.from_surroundings = constants.surroundings_layer(decoder.from_surroundings)
        self.head = constants.merged_heads(decoder.heads, model.config.output_gain)
        self.strain, self.contact = Strain(), Contact()
        self.based, self.closes = model.config.agreed_base, model.config.closing_fit
        self.corrections = nn.ModuleList(
            constants.correction_layers(correction, model.config.output_gain) for correction in model.corrections
        )
        for name, value in constants.tables().items():
            self.register_buffer(name, value)
        self.jumps = [f"jump_{i}" for i, _ in enumerate(constants.ancestor_jumps())]
        for name, value in zip(self.jumps, constants.ancestor_jumps(), strict=True):
            self.register_buffer(name, value)

    def forward(
        self,
        joint_quaternion: Tensor,
        joint_rest: Tensor,
        betas: Tensor,
        patch_first: Tensor,
        patch_weights: Tensor,
        patch_rotation: Tensor,
        patch_scale: Tensor,
        patch_centre: Tensor,
        patch_shapedirs: Tensor,
        tile_positions: Tensor,
        tile_tangents: Tensor,
        patch_stored: Tensor,
        patch_body: Tensor,
        patch_bone: Tensor,
        tile_stored: Tensor,
        tile_patch: Tensor,
        vertex_charts: Tensor,
        block_item: Tensor,
        item_blocks: Tensor,
        dynamic_code: Tensor | None = None,
        anchor_columns: Tensor | None = None,
        anchor_fit: Tensor | None = None,
        anchor_rest: Tensor | None = None,
        strain_tangent: Tensor | None = None,
        strain_unit: Tensor | None = None,
        anchor_charts: Tensor | None = None,
        member_anchor: Tensor | None = None,
        skin_rows: Tensor | None = None,
        skin_bones: Tensor | None = None,
        body_shape: Tensor | None = None,
        felt_place: Tensor | None = None,
        felt_cluster: Tensor | None = None,
        felt_bias: Tensor | None = None,
        felt_other: Tensor | None = None,
        felt_region: Tensor | None = None,
    ) -> tuple[Tensor, ...]:
        skins = felt = None
        if skin_rows is not None:
            assert skin_bones is not None and body_shape is not None and felt_place is not None
            assert felt_cluster is not None and felt_bias is not None
            assert felt_other is not None and felt_region is not None
            skins = Skins(skin_rows, skin_bones, body_shape)
            felt_tables = (felt_place, felt_cluster, felt_bias, felt_other, felt_region)
            felt = Felt(*(_rows(table, patch_stored) for table in felt_tables))
        bodies = Bodies(joint_quaternion, joint_rest, betas, dynamic_code, skins)
        patches = Patches(patch_first, patch_weights, patch_rotation, patch_scale, patch_centre, patch_shapedirs)
        charts = None
        if anchor_columns is not None:
            assert anchor_fit is not None and anchor_rest is not None and strain_tangent is not None
            assert strain_unit is not None and anchor_charts is not None and member_anchor is not None
            stored = (anchor_columns, anchor_fit, anchor_rest, strain_tangent, strain_unit)
            columns, fit, rest, tangent, unit = (_rows(table, patch_stored) for table in stored)
            charts = Charts(columns, fit, rest, tangent, unit, anchor_charts, member_anchor)
        posed = self.pose(bodies, patches, patch_stored, patch_body, patch_bone, charts, felt)
        coefficients = _rows(posed.coefficients, tile_patch)  # (Q, 3, 18)
        vertices = self.blend(coefficients, _rows(tile_positions, tile_stored), vertex_charts)
        tangents = self.blend(coefficients, _rows(tile_tangents, tile_stored), vertex_charts, count=2)
        steps, low, step = _quantised(vertices, block_item, item_blocks)
        return (
            vertices, self._normals(tangents), steps, low, step, posed.jet,
            posed.rotation, posed.centre.reshape(-1, 3), posed.bone_rotation, posed.bone_translation,
            *(() if posed.skin is None else (posed.skin,)), *posed.passes,
        )  # fmt: skip

    def pose(
        self,
        bodies: Bodies,
        patches: Patches,
        patch_stored: Tensor | None,
        patch_body: Tensor,
        patch_bone: Tensor,
        charts: Charts | None = None,
        felt: Felt | None = None,
    ) -> PosedPatches:
        """Posed jets of the patches ``patch_stored``, or of all ``patches`` in order where it is None."""
        quaternion, bone_rotation, joints = self._posed_joints(bodies.joint_quaternion, bodies.joint_rest)
        bone_translation = joints - (bone_rotation @ bodies.joint_rest[..., None])[..., 0]
        code = self.body(self._features(bodies.joint_quaternion, bone_rotation, bodies.betas))
        if bodies.dynamic_code is not None:
            code = code + bodies.dynamic_code

        weights = _rows(patches.weights, patch_stored)
        blended = self._blended_rotation(quaternion, weights, patch_body, patch_bone)
        rotation = blended @ _rows(patches.rotation, patch_stored)
        centre = _skinned(
            _rows(patches.centre, patch_stored),
            _rows(patches.shapedirs, patch_stored),
            _rows(bodies.betas, patch_body),
            weights,
            torch.cat([bone_rotation, bone_translation[..., None]], dim=-1).reshape(-1, JOINT_COUNT, 12),
            patch_body,
        )
        scale = _rows(patches.scale, patch_stored)[:, :, None]
        frame = torch.cat([rotation * scale, centre], dim=-1)  # (P, 3, 4)
        into = rotation / scale
        base = None
        if self.based:
            assert charts is not None
            base = self._fitted(frame @ charts.columns[:, :4], charts, into, centre, self.fit_choice)
        x = _rows(patches.first, patch_stored) + _rows(self.from_body(code), patch_body)
        if self.from_surroundings is not None:
            x = self._with_surroundings(x, _rows(joints.mT, patch_body), rotation, centre, base)
        hidden = self.trunk(nn.functional.leaky_relu(x, SLOPE))
        jet = self.head(hidden) if base is None else base + self.head(hidden)
        passes = [jet]
        columns = self._columns(charts.columns) if charts is not None else None
        skin = near = stretch = places = None
        if bodies.skins is not None:
            skin = posed_skins(bodies.skins, bone_rotation, bone_translation)
        for correction in self.corrections:
            assert charts is not None and columns is not None
            jet = self._fitted(self._posed(frame, jet) @ columns, charts, into, centre, self.fit_choice)
            stretch = self.strain.stretch(charts.tangent, charts.unit) if stretch is None else stretch
            inputs = [hidden, *self.strain(jet, stretch), jet]
            if felt is not None:
                assert skin is not None
                places = self.contact.places(felt) if places is None else places
                points = self.contact.points(jet, places)
                if near is None:
                    near = self.contact.near(points, skin, felt, patch_body, rotation, scale, centre)
                inputs += self.contact(points, near)
            jet = jet + correction(torch.cat(inputs, dim=-1))
            passes.append(jet)
        if self.closes:
            assert charts is not None and columns is not None
            jet = self._fitted(self._posed(frame, jet) @ columns, charts, into, centre, self.full_choice)
        kept = tuple(passes) if self.closes and len(passes) > 1 else ()
        return PosedPatches(self._posed(frame, jet), jet, rotation, centre, bone_rotation, bone_translation, skin, kept)

    def _posed(self, frame: Tensor, jet: Tensor) -> Tensor:
        """Posed jets (P, 3, 18) of ``jet`` (P, 27 or 45) in scaled frames (P, 3, 4)."""
        placed = self.placed_full if jet.shape[-1] == jets.FULL_COUNT else self.placed
        return frame @ torch.addmm(self.frame_only, jet, placed).reshape(-1, 4, COLUMNS)

    def _fitted(self, said: Tensor, charts: Charts, into: Tensor, centre: Tensor, choice: Tensor) -> Tensor:
        """``training.agreement.agreed_jets`` (P, 27), or ``closing_jets`` (P, 45), of what each chart says of its
        members (P, 3, 56): ``choice`` picks those of the 63 numbers that are fitted."""
        anchors = self._blended(said, charts.anchor_charts)
        # Coordinates first: three rows of many columns, the shape that small products and differences are fast in.
        places = torch.index_select(anchors, 1, charts.member_anchor.reshape(-1)).reshape(3, -1, MEMBERS)
        local = into.mT @ ((places.transpose(0, 1) - centre) @ charts.fit)
        # Picked by a product: a Gather of columns takes three times as long.
        return torch.addmm(charts.rest @ choice, local.reshape(-1, 3 * FIT_COUNT), choice, beta=-1)

    def _columns(self, stored: Tensor) -> Tensor:
        """Columns (P, 18, 56) of the anchors from those up to the second order (P, 9, 56): (w a) (w b) / w is w a b."""
        weight = torch.clamp(stored[:, 3:4], min=1e-30)
        higher = torch.index_select(stored, 1, self.higher_first) * torch.index_select(stored, 1, self.higher_second)
        return torch.cat([stored, higher / weight], dim=1)

    def _blended(self, said: Tensor, charts: Tensor) -> Tensor:
        """Sums (3, n) over the four ``charts`` (4, ...) of each of n points, of what charts say (Q, 3, columns)."""
        rows = said.transpose(0, 1).reshape(3, -1)
        taken = torch.index_select(rows, 1, charts.reshape(-1))
        return self.chart_sums @ taken.reshape(3 * CHARTS_PER_VERTEX, -1)

    def blend(self, coefficients: Tensor, columns: Tensor, vertex_charts: Tensor, *, count: int = 1) -> Tensor:
        """Sums (blocks, 64, 3 * count) over every vertex's charts of tiles (Q, 3, 18) @ (Q, 18, 64 * count)."""
        product = coefficients @ columns
        if count == 1:
            return self._blended(product, vertex_charts).mT.reshape(-1, VERTICES_PER_BLOCK, 3)
        parts = [self._blended(part, vertex_charts) for part in product.split(CHARTS_PER_TILE, dim=-1)]
        return torch.stack(parts, dim=1).reshape(3 * count, -1).mT.reshape(-1, VERTICES_PER_BLOCK, 3 * count)

    def _posed_joints(self, local: Tensor, rest: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """World quaternions (B, 24, 4), rotations (B, 24, 3, 3) and joints [m] (B, 24, 3) of bodies.

        ``rigid.bone_transforms`` by doubling: four rounds of products reach the root of a tree nine joints deep.
        Row 24 of ``local`` is the identity, the ancestor of those that have none left.
        """
        product = (local @ self.left_terms).reshape(-1, JOINT_COUNT + 1, 4, 4)
        for name in self.jumps:
            product = torch.index_select(product, 1, getattr(self, name)) @ product
        quaternion = product[:, :JOINT_COUNT, :, 0]
        rotation = self._matrices(quaternion.reshape(-1, 4)).reshape(-1, JOINT_COUNT, 3, 3)
        # A joint moves with its parent's rotation: the sum of all offsets between it and the root.
        offset = (self.offsets @ rest)[..., None]
        turned = (torch.index_select(rotation, 1, self.parents) @ offset).reshape(-1, JOINT_COUNT, 3)
        return quaternion, rotation, self.descent @ turned

    def _features(self, local: Tensor, rotation: Tensor, betas: Tensor) -> Tensor:
        """``drape.body.features.static_features`` and the shape (B, 226)."""
        relative = torch.index_select(local, 1, self.without_root)  # the root's own turn is not told
        outer = (relative[..., :, None] * relative[..., None, :]).reshape(-1, JOINT_COUNT, 16)
        parts = [self.neutral + outer @ self.sixd_terms, -rotation[:, :, 1, :]]
        static = torch.cat(parts, dim=-1).reshape(-1, JOINT_COUNT * STATIC_PER_JOINT)
        return torch.cat([static, betas], dim=-1)

    def _matrices(self, quaternion: Tensor) -> Tensor:
        """Rotation matrices (n, 9) of quaternions (n, 4) of any length: of q q^T over |q|^2."""
        outer = (quaternion[:, :, None] * quaternion[:, None, :]).reshape(-1, 16)
        terms = outer @ self.rotation_terms
        return self.identity + terms[:, :9] / terms[:, 9:]

    def _blended_rotation(self, quaternion: Tensor, weights: Tensor, patch_body: Tensor, patch_bone: Tensor) -> Tensor:
        """Rotations (P, 3, 3) of ``drape.geometry.skinning.blend_frames``, signs taken once per pair of bones."""
        agreement = quaternion @ quaternion.mT  # (B, 24, 24)
        sign = torch.where(agreement < 0.0, -1.0, 1.0).reshape(-1, JOINT_COUNT)
        signed = weights * _rows(sign, patch_bone)
        reference = _rows(quaternion.reshape(-1, 4), patch_bone)
        mixed = (signed[:, None, :] @ _rows(quaternion, patch_body)).reshape(-1, 4) + 1e-6 * reference
        return self._matrices(mixed).reshape(-1, 3, 3)

    def _with_surroundings(
        self, x: Tensor, joints: Tensor, rotation: Tensor, centre: Tensor, base: Tensor | None
    ) -> Tensor:
        """``x`` plus the layer on ``training.model.patch_surroundings`` of posed joints (P, 3, 24), and on ``base``."""
        assert self.from_surroundings is not None
        offset = rotation.mT @ (joints - centre)
        # A maximum and not a sum: the exporter's optimiser takes "+ 1e-12" for "+ 0" and drops the guard.
        squared = ((offset * offset).reshape(-1, 3 * JOINT_COUNT) @ self.axis_sums).reshape(-1, 1, JOINT_COUNT)
        reach = torch.sqrt(torch.clamp(squared, min=1e-12))
        saturated = (offset * (torch.tanh(reach * (1.0 / REACH_M)) / reach)).reshape(-1, 3 * JOINT_COUNT)
        parts = [saturated, rotation.reshape(-1, 9), *([] if base is None else [base])]
        return torch.addmm(x, torch.cat(parts, dim=-1), self.from_surroundings)

    def _normals(self, tangents: Tensor) -> Tensor:
        """Unit cross products (blocks, 64, 3) of the tangents (blocks, 64, 6), which lie as x, x', y, y', z, z'."""
        a, b, c, d = (tangents @ self.cross_terms).split(3, dim=-1)
        normal = a * b - c * d
        squared = (normal * normal).sum(dim=-1, keepdim=True)
        return normal / torch.sqrt(torch.clamp(squared, min=1e-24))


def _rows(table: Tensor, index: Tensor | None) -> Tensor:
    return table if index is None else torch.index_select(table, 0, index)


def _skinned(
    centre: Tensor, shapedirs: Tensor, betas: Tensor, weights: Tensor, bones: Tensor, patch_body: Tensor
) -> Tensor:
    """Centres (P, 3, 1) [m]: rest centres (P, 4) moved by the shape, then by the blended bones (B, 24, 12)."""
    rest = centre[:, :, None] + shapedirs @ betas[:, :, None]
    blended = weights[:, None, :] @ _rows(bones, patch_body)
    return blended.reshape(-1, 3, 4) @ rest


def _quantised(vertices: Tensor, block_item: Tensor, item_blocks: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """``drape.wire.quantise`` of every item: steps (blocks, 64, 3), low corners and steps [m] (I, 3).

    A vertex that is not finite makes the low corner of its item NaN.
    """
    per_item = item_blocks.shape[1]

    def of_items(values: Tensor) -> Tensor:
        return _rows(values, item_blocks.reshape(-1)).reshape(-1, per_item, 3)

    low = of_items(vertices.amin(dim=1)).amin(dim=1)
    high = of_items(vertices.amax(dim=1)).amax(dim=1)
    step = torch.clamp((high - low) / STEP_COUNT, min=1e-9)
    places = (vertices - _rows(low, block_item)[:, None]) / _rows(step, block_item)[:, None]
    steps = torch.clamp(torch.round(places), 0, STEP_COUNT).to(torch.uint16)
    return steps, low + 0.0 * of_items(vertices.sum(dim=1)).sum(dim=1), step
