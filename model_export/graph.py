"""The graphs that are exported, with their input and output names fixed here."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from drape.artifacts import TensorSpec
from drape.garment.agreement import FIT_COUNT, MEMBERS, STRAIN_POINTS
from drape.push.proximity import PatchSkin
from drape.push.samples import CLUSTER_SIZE, REGION_SIZE
from drape.push.tables import OWN_CLUSTERS
from training.agreement import GatheredAgreement
from training.model import BodyTensors, OneFit, PatchTensors, paper_vertices, vertex_positions

BODY_INPUTS: tuple[TensorSpec, ...] = (
    TensorSpec("body_features", ("frames", 226), "float32", "1"),
    TensorSpec("bone_rotation", ("frames", 24, 3, 3), "float32", "1"),
    TensorSpec("bone_translation", ("frames", 24, 3), "float32", "m"),
    TensorSpec("bone_quaternion", ("frames", 24, 4), "float32", "1"),
    TensorSpec("betas", ("frames", 10), "float32", "standard deviations"),
)
JOINT_INPUT = TensorSpec("body_joints", ("frames", 24, 3), "float32", "m, relative to the root joint")
PATCH_INPUTS: tuple[TensorSpec, ...] = (
    TensorSpec("patch_centre", ("patches", 3), "float32", "m"),
    TensorSpec("patch_rotation", ("patches", 3, 3), "float32", "1"),
    TensorSpec("patch_scale", ("patches",), "float32", "m"),
    TensorSpec("patch_weights", ("patches", 24), "float32", "1"),
    TensorSpec("patch_heaviest", ("patches",), "int64", "bone index"),
    TensorSpec("patch_shapedirs", ("patches", 3, 10), "float32", "m"),
)
CHART_INPUTS: tuple[TensorSpec, ...] = (
    TensorSpec("chart_patch", ("vertices", 4), "int64", "patch index"),
    TensorSpec("chart_weight", ("vertices", 4), "float32", "1"),
    TensorSpec("chart_basis", ("vertices", 4, 15), "float32", "1"),
    TensorSpec("chart_local", ("vertices", 4, 3), "float32", "m"),
)
AGREEMENT_INPUTS: tuple[TensorSpec, ...] = (
    TensorSpec("anchor_patch", ("anchors", 4), "int64", "patch index"),
    TensorSpec("anchor_row", ("anchors", 4, 19), "float32", "1 and m"),
    TensorSpec("patch_member", ("patches", MEMBERS), "int64", "anchor index"),
    TensorSpec("patch_fit", ("patches", FIT_COUNT, MEMBERS), "float32", "1"),
    TensorSpec("patch_rest", ("patches", FIT_COUNT, 3), "float32", "patch scales"),
    TensorSpec("patch_tangent", ("patches", STRAIN_POINTS, 3, 2), "float32", "1"),
    TensorSpec("patch_orthonormal", ("patches", STRAIN_POINTS, 2, 2), "float32", "1"),
)
# Of networks that feel the body; its skin comes posed, since this graph is the one to read.
CONTACT_INPUTS: tuple[TensorSpec, ...] = (
    TensorSpec("body_skin", ("frames", "regions", REGION_SIZE, 8), "float32", "m and 1, relative to the root joint"),
    TensorSpec("patch_place", ("patches", STRAIN_POINTS, 3), "float32", "m"),
    TensorSpec("patch_cluster", ("patches", OWN_CLUSTERS), "int64", "cluster of samples"),
    TensorSpec("patch_cluster_bias", ("patches", OWN_CLUSTERS * CLUSTER_SIZE), "float32", "1"),
    TensorSpec("patch_other", ("patches", "regions", REGION_SIZE), "uint8", "1 / 15"),
    TensorSpec("patch_region_bias", ("patches", "regions"), "float32", "1"),
)
SKIN_INPUT = TensorSpec("skin_weights", ("vertices", 24), "float32", "1")
MOTION_INPUT = TensorSpec("motion_features", ("clients", 24, 12), "float32", "1/s and m/s^2")
STEP_INPUT = TensorSpec("dt_s", ("clients",), "float32", "s")


def drape_inputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Inputs of the drape graph of ``model``, in order."""
    embedding = TensorSpec("patch_embedding", ("patches", model.config.embedding_size), "float32", "1")
    skin = (SKIN_INPUT,) if model.config.variant == "paper" else ()
    joints = (JOINT_INPUT,) if model.config.surroundings else ()
    code = TensorSpec(
        "dynamic_code", ("frames", model.config.body_code_size), "float32", "1, scaled by the motion knob"
    )
    motion = (code,) if model.config.dynamic else ()
    charts = AGREEMENT_INPUTS if model.agrees else ()
    contact = CONTACT_INPUTS if model.config.feels_body else ()
    return (*BODY_INPUTS, embedding, *PATCH_INPUTS, *CHART_INPUTS, *skin, *joints, *motion, *charts, *contact)


def drape_outputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Outputs of the drape graph of ``model``, in order."""
    return (
        TensorSpec("vertices", ("frames", "vertices", 3), "float32", "m, relative to the root joint"),
        TensorSpec("jet", ("frames", "patches", model.jet_count), "float32", "patch scales"),
        TensorSpec("frame_rotation", ("frames", "patches", 3, 3), "float32", "1"),
        TensorSpec("frame_centre", ("frames", "patches", 3), "float32", "m, relative to the root joint"),
    )


def dynamic_inputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Inputs of the dynamic encoder graph of a dynamic ``model``."""
    return MOTION_INPUT, TensorSpec("state", ("clients", model.config.state_size), "float32", "1"), STEP_INPUT


def dynamic_outputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Outputs of the dynamic encoder graph."""
    return (
        TensorSpec("dynamic_code", ("clients", model.config.body_code_size), "float32", "1"),
        TensorSpec("next_state", ("clients", model.config.state_size), "float32", "1"),
    )


def encoder_inputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Inputs of the garment encoder graph."""
    return (TensorSpec("patch_features", ("patches", model.config.patch_feature_count), "float32", "1"),)


def encoder_outputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Outputs of the garment encoder graph."""
    return (TensorSpec("patch_embedding", ("patches", model.config.embedding_size), "float32", "1"),)


class EncoderGraph(nn.Module):
    """Patch features -> patch embedding; run once per garment."""

    def __init__(self, model: OneFit) -> None:
        super().__init__()
        self.garment = model.garment

    def forward(self, patch_features: Tensor) -> Tensor:
        return self.garment(patch_features)


class DynamicGraph(nn.Module):
    """Motion and state of every client -> code to add to its pose's, and its next state; run once per frame."""

    def __init__(self, model: OneFit) -> None:
        super().__init__()
        assert model.dynamic is not None
        self.dynamic = model.dynamic

    def forward(self, motion_features: Tensor, state: Tensor, dt_s: Tensor) -> tuple[Tensor, Tensor]:
        return self.dynamic(motion_features, state, dt_s)


class DrapeGraph(nn.Module):
    """A pose and a garment -> vertices, added jets and posed frames."""

    def __init__(self, model: OneFit) -> None:
        super().__init__()
        self.model = model

    def forward(
        self,
        body_features: Tensor,
        bone_rotation: Tensor,
        bone_translation: Tensor,
        bone_quaternion: Tensor,
        betas: Tensor,
        patch_embedding: Tensor,
        patch_centre: Tensor,
        patch_rotation: Tensor,
        patch_scale: Tensor,
        patch_weights: Tensor,
        patch_heaviest: Tensor,
        patch_shapedirs: Tensor,
        chart_patch: Tensor,
        chart_weight: Tensor,
        chart_basis: Tensor,
        chart_local: Tensor,
        skin_weights: Tensor | None = None,
        body_joints: Tensor | None = None,
        dynamic_code: Tensor | None = None,
        anchor_patch: Tensor | None = None,
        anchor_row: Tensor | None = None,
        patch_member: Tensor | None = None,
        patch_fit: Tensor | None = None,
        patch_rest: Tensor | None = None,
        patch_tangent: Tensor | None = None,
        patch_orthonormal: Tensor | None = None,
        body_skin: Tensor | None = None,
        patch_place: Tensor | None = None,
        patch_cluster: Tensor | None = None,
        patch_cluster_bias: Tensor | None = None,
        patch_other: Tensor | None = None,
        patch_region_bias: Tensor | None = None,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        body = BodyTensors(
            body_features, bone_rotation, bone_translation, bone_quaternion, betas, body_joints, body_skin
        )
        near = None
        if patch_cluster is not None:
            assert patch_cluster_bias is not None and patch_other is not None and patch_region_bias is not None
            near = PatchSkin(patch_cluster, patch_cluster_bias, patch_other, patch_region_bias)
        patches = PatchTensors(
            patch_centre, patch_rotation, patch_scale, patch_weights, patch_heaviest, patch_shapedirs, patch_place, near
        )
        tables = (anchor_patch, anchor_row, patch_member, patch_fit, patch_rest, patch_tangent, patch_orthonormal)
        given = [table for table in tables if table is not None]
        charts = GatheredAgreement(*given) if given else None
        posed = self.model(body, patches, patch_embedding, dynamic_code, charts=charts)
        vertices = vertex_positions(posed, patches, chart_patch, chart_weight, chart_basis, chart_local)
        if skin_weights is not None:
            vertices = paper_vertices(vertices, skin_weights, body)
        return vertices, posed.jet, posed.rotation + torch.zeros_like(posed.centre[..., None]), posed.centre
