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

import onnxscript
import torch
from torch import Tensor, nn

from drape.body.features import STATIC_PER_JOINT
from drape.body.skeleton import JOINT_COUNT
from drape.errors import ArtifactError
from drape.garment.agreement import FIT_COUNT, MEMBERS, STRAIN_POINTS
from drape.garment.cache import CHARTS_PER_VERTEX
from drape.garment.features import REACH_M
from drape.geometry import jets
from drape.geometry.rotations import dot_columns
from drape.packing import CHARTS_PER_TILE, COLUMNS, VERTICES_PER_BLOCK
from drape.wire import STEP_COUNT
from model_export import packed_weights as constants
from model_export.packed_contact import Felt, Skins, felt_inputs, near_planes, posed_skins
from model_export.packed_parts import Bodies, Charts, Patches, PosedPatches
from training.agreement import TANGENT_COUNT, TRACE_SHARE, softened
from training.layers import SLOPE
from training.model import OneFit


def _gather(table, dim, index):
    """``torch.index_select`` as one Gather; the exporter's own adds a Reshape and a Cast to every index."""
    return onnxscript.opset20.Gather(table, index, axis=dim)


TRANSLATIONS = {torch.ops.aten.index_select.default: _gather}


class FirstGraph(nn.Module):
    """Patch features -> patch embedding, and the garment half of the decoder's first layer; run once per garment."""

    def __init__(self, model: OneFit) -> None:
        super().__init__()
        self.garment, self.from_patch = model.garment, model.decoder.from_patch

    def forward(self, patch_features: Tensor) -> tuple[Tensor, Tensor]:
        embedding = self.garment(patch_features)
        return embedding, self.from_patch(embedding)


class PackedGraph(nn.Module):
    """Bodies, stored garments and the index tensors of ``drape.packing`` -> all of ``packed_specs.packed_outputs``.

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
    fit_columns: Tensor
    full_columns: Tensor
    strain_terms: Tensor
    ones: Tensor
    felt_terms: Tensor

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
            posed.rotation, posed.centre.reshape(-1, 3), posed.bone_rotation, posed.bone_translation, *posed.passes,
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
            base = self._fitted(frame @ charts.columns[:, :4], charts, into, centre, self.fit_columns)
        x = _rows(patches.first, patch_stored) + _rows(self.from_body(code), patch_body)
        if self.from_surroundings is not None:
            x = self._with_surroundings(x, _rows(joints.mT, patch_body), rotation, centre, base)
        hidden = self.trunk(nn.functional.leaky_relu(x, SLOPE))
        jet = self.head(hidden) if base is None else base + self.head(hidden)
        passes = [jet]
        skin = near = None
        if bodies.skins is not None:
            skin = posed_skins(bodies.skins, bone_rotation, bone_translation)
        for correction in self.corrections:
            assert charts is not None
            jet = self._fitted(self._posed(frame, jet) @ charts.columns, charts, into, centre, self.fit_columns)
            strain, force = self._strain(jet, charts)
            inputs = [hidden, softened(strain), softened(force), jet]
            if felt is not None:
                assert skin is not None
                points = self._felt_points(self._posed(frame, jet), felt)
                near = near_planes(points, skin, felt, patch_body) if near is None else near
                inputs += felt_inputs(points, near, rotation, self.felt_terms)
            jet = jet + correction(torch.cat(inputs, dim=-1))
            passes.append(jet)
        if self.closes:
            assert charts is not None
            jet = self._fitted(self._posed(frame, jet) @ charts.columns, charts, into, centre, self.full_columns)
        kept = tuple(passes) if self.closes and len(passes) > 1 else ()
        return PosedPatches(self._posed(frame, jet), jet, rotation, centre, bone_rotation, bone_translation, kept)

    def _posed(self, frame: Tensor, jet: Tensor) -> Tensor:
        """Posed jets (P, 3, 18) of ``jet`` (P, 27 or 45) in scaled frames (P, 3, 4)."""
        placed = self.placed_full if jet.shape[-1] == jets.FULL_COUNT else self.placed
        return frame @ torch.addmm(self.frame_only, jet, placed).reshape(-1, 4, COLUMNS)

    def _felt_points(self, posed: Tensor, felt: Felt) -> Tensor:
        """Where patches of posed jets (P, 3, 18) feel the body [m] (P, 3, 7)."""
        moved = (posed[:, :, 3:].reshape(-1, jets.HEIGHT_COUNT) @ self.felt_terms.mT).reshape(-1, 3, STRAIN_POINTS)
        return posed[:, :, :3] @ felt.place + moved

    def _fitted(self, said: Tensor, charts: Charts, into: Tensor, centre: Tensor, numbers: Tensor) -> Tensor:
        """``training.agreement.agreed_jets`` (P, 27), or ``closing_jets`` (P, 45), of what each chart says of its
        members (P, 3, 56): those ``numbers`` of the 63 that are fitted."""
        rows = said.mT.reshape(-1, 3)
        anchors = (self.ones @ _rows(rows, charts.anchor_charts.reshape(-1)).reshape(CHARTS_PER_VERTEX, -1)).reshape(
            -1, 3
        )
        # Coordinates first: three rows of many columns, the shape that small products and differences are fast in.
        places = _rows(anchors, charts.member_anchor.reshape(-1)).reshape(-1, MEMBERS, 3).mT
        local = into.mT @ ((places - centre) @ charts.fit)
        return torch.index_select(local.reshape(-1, 3 * FIT_COUNT) - charts.rest, 1, numbers)

    def _strain(self, jet: Tensor, charts: Charts) -> tuple[Tensor, Tensor]:
        """``training.agreement.strain_and_force``: strain (P, 21) and force (P, 27)."""
        tangent = torch.addmm(charts.tangent, jet, self.strain_terms).reshape(-1, 2, 3, STRAIN_POINTS)
        a, b, c = charts.unit.split(1, dim=1)  # (P, 1, 7)
        by_u, by_v = tangent[:, 0], tangent[:, 1]
        u, v = a * by_u, b * by_u + c * by_v
        e11 = 0.5 * dot_columns(u, u) - 0.5
        e22 = 0.5 * dot_columns(v, v) - 0.5
        e12 = 0.5 * dot_columns(u, v)
        trace = TRACE_SHARE * (e11 + e22)
        along_u, along_v = (e11 + trace) * u + e12 * v, e12 * u + (e22 + trace) * v
        pull = torch.cat([a * along_u + b * along_v, c * along_v], dim=1).reshape(-1, TANGENT_COUNT)
        return torch.cat([e11, e22, 2.0 * e12], dim=1).reshape(-1, 3 * STRAIN_POINTS), pull @ self.strain_terms.mT

    def blend(self, coefficients: Tensor, columns: Tensor, vertex_charts: Tensor, *, count: int = 1) -> Tensor:
        """Sums (blocks, 64, 3 * count) over every vertex's charts of tiles (Q, 3, 18) @ (Q, 18, 64 * count)."""
        width = 3 * count
        product = coefficients @ columns
        rows = product.reshape(-1, width, CHARTS_PER_TILE).mT.reshape(-1, width)
        gathered = _rows(rows, vertex_charts.reshape(-1)).reshape(CHARTS_PER_VERTEX, -1)
        return (self.ones @ gathered).reshape(-1, VERTICES_PER_BLOCK, width)

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
        reach = torch.sqrt(torch.clamp((offset * offset).sum(dim=1, keepdim=True), min=1e-12))
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
