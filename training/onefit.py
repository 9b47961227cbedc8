"""The draping network: patches and a pose in, posed patches and vertices out."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from drape.contact.proximity import Planes, body_proximity, held_share, planes
from drape.garment.consensus import strain_points
from drape.garment.patch_features import saturated
from drape.geometry import jets
from drape.geometry.skinning import blend_frames, skin_points
from drape.graph.inputs import BodyTensors, ChartTensors, PatchTensors
from training.chart_consensus import (
    ChartConsensus,
    agreed_jets,
    closing_jets,
    softened,
    strain_and_force,
    tangent_terms,
)
from training.config import ModelConfig
from training.layers import Correction, Decoder, GarmentEncoder, StaticEncoder
from training.recurrent import DynamicEncoder


@dataclass(frozen=True)
class Posed:
    """K patches on F posed bodies: ``rotation`` (F, K, 3, 3) and ``centre`` (F, K, 3) [m] are their frames, relative to
    the root joint.

    ``jet`` (F, K, 45) [patch scales] are the changes of their full rest jets (``drape.geometry.jets``). Of variant
    "paper" the frames are those of the rest pose, and ``jet`` (F, K, 27) are the changes of the rest jets, which are
    not full.
    """

    rotation: Tensor
    centre: Tensor
    jet: Tensor


class OneFit(nn.Module):
    """The network of OneFit (section 3, appendix A.3) with vector jets in rigidly skinned frames.

    Past the paper, in four steps (docs/architecture.md): charts start where the blend of the rigid ones is, the
    decoder predicts a change of each, a few passes bring charts to a consensus and correct them by their strain and
    the proximity of the body, and a closing fit of higher order makes them say what the blend says. The passes are a
    learned solver: each reads how far off the drape still is.

    Variant "paper" predicts a height jet, a translation and a scale of each patch in
    the rest pose; its vertices are skinned afterwards. Raises ``ValueError`` for another variant, and for corrections
    of variant "paper".
    """

    tangent_terms: Tensor
    felt_terms: Tensor

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.garment = GarmentEncoder(config)
        self.body = StaticEncoder(config)
        self.dynamic = DynamicEncoder(config) if config.dynamic else None
        if config.vector:
            heads = {"plane": 2 * jets.IN_PLANE_COUNT, "height": jets.HEIGHT_COUNT}
        elif config.variant == "paper":
            heads = {"height": jets.HEIGHT_COUNT, "translation": 3, "scale": 1}
        else:
            raise ValueError(f"variant: expected 'vector' or 'paper', got {config.variant!r}. Choose one of them.")
        if config.corrections and not config.vector:
            raise ValueError(f"corrections: expected 0 with variant {config.variant!r}, got {config.corrections}.")
        self.decoder = Decoder(config, heads)
        self.corrections = nn.ModuleList(Correction(config) for _ in range(config.corrections))
        self.register_buffer("tangent_terms", tangent_terms(), persistent=False)
        terms = jets.basis(strain_points(), jets.HEIGHT_ORDER).T  # (15, 7)
        self.register_buffer("felt_terms", torch.from_numpy(terms.copy()).float(), persistent=False)
        self.autocast = False  # for the layers alone: places in space need float32

    def _felt(self, rotation: Tensor, points: Tensor, near: Planes) -> list[Tensor]:
        """Closeness (F, K, 14) of the posed body to ``points`` of the patches, and its force on the jets (F, K, 27)."""
        closeness, push = body_proximity(points, near)
        along = (push @ rotation).mT @ self.felt_terms.T  # (F, K, 3, 15)
        plane, height = along[..., : jets.IN_PLANE_COUNT], along[..., 2, :]
        return [closeness, softened(torch.cat([plane[..., 0, :], plane[..., 1, :], height], dim=-1) / 4.0)]

    def _points(self, jet: Tensor, rotation: Tensor, centre: Tensor, patches: PatchTensors) -> Tensor:
        """Places [m] (F, K, 7, 3) of the strain points of posed patches."""
        assert patches.place is not None
        moved = jets.full(jet).unflatten(-1, (3, -1)) @ self.felt_terms  # (F, K, 3, 7)
        local = patches.place + patches.scale[:, None, None] * moved.mT
        return local @ rotation.mT + centre[:, :, None]

    @property
    def jet_count(self) -> int:
        """How many numbers the jet of a patch has in what ``forward`` returns: 45, of variant "paper" 27."""
        return jets.FULL_COUNT if self.config.vector else jets.JET_COUNT

    def _mixed(self, like: Tensor) -> AbstractContextManager:
        if not self.autocast:
            return nullcontext()
        return torch.autocast(like.device.type, dtype=torch.bfloat16)

    def predict(
        self,
        body: BodyTensors,
        embedding: Tensor,
        surroundings: Tensor | None = None,
        dynamic_code: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Returns the decoder's change of the jets (F, K, 27) [patch scales], and its code of each patch (F, K, W)."""
        with self._mixed(embedding):
            code = self.body(body.features)
            if dynamic_code is not None:
                code = code + dynamic_code
            out, hidden = self.decoder(code, embedding, surroundings)
        out = {name: value.float() for name, value in out.items()} if self.autocast else out
        gain = self.config.output_gain
        if self.config.vector:
            return gain * torch.cat([out["plane"], out["height"]], dim=-1), hidden
        return gain * torch.cat(_paper_as_vector(out), dim=-1), hidden

    def forward(
        self,
        body: BodyTensors,
        patches: PatchTensors,
        embedding: Tensor,
        dynamic_code: Tensor | None = None,
        *,
        charts: ChartConsensus | None = None,
        passes: int | None = None,
    ) -> Posed:
        """Returns ``patches``, whose embeddings are ``embedding`` (K, E), on the F bodies ``body``.

        ``dynamic_code`` (F, 256), times the motion knob, is added to the code of the pose. ``charts`` are the garment's
        tables, which vector jets need. ``passes`` of the corrections are taken, all of them by default.
        """
        rotation, centre = pose_frames(body, patches)
        around = base = None
        if self.config.vector:
            assert charts is not None
            frames = torch.cat([centre[..., None, :], rotation.mT], dim=-2)
            base = agreed_jets(charts.anchors(frames), charts, rotation, centre, patches.scale)
            around = torch.cat([patch_surroundings(body, rotation, centre), base], dim=-1)
        jet, hidden = self.predict(body, embedding, around, dynamic_code)
        jet = jet if base is None else base + jet
        near = None  # tangent planes of the body, looked up once: corrections move patches by less than they are wide
        for correction in self.corrections[:passes]:
            assert charts is not None
            anchors = charts.anchors(posed_coefficients(Posed(rotation, centre, jet), patches.scale))
            jet = agreed_jets(anchors, charts, rotation, centre, patches.scale)
            strain, force = strain_and_force(jet, charts, self.tangent_terms)
            # Proximity is an input alone: no gradient flows through it.
            with torch.no_grad():
                points = self._points(jet, rotation, centre, patches)
                if near is None:
                    assert patches.skin is not None and body.skin is not None
                    near = planes(points, body.skin, patches.skin)
                body_felt = self._felt(rotation, points, near)
            with self._mixed(hidden):
                change = correction(hidden, strain, force, jet, body_felt)
            change = self.config.output_gain * (change.float() if self.autocast else change)
            with torch.no_grad():
                held = held_share(points, self._points(jet + change, rotation, centre, patches), near)
            jet = jet + held[..., None] * change
        if self.config.vector:
            assert charts is not None
            anchors = charts.anchors(posed_coefficients(Posed(rotation, centre, jet), patches.scale))
            jet = closing_jets(anchors, charts, rotation, centre, patches.scale)
        else:
            rotation, centre = rest_frames(body, patches)
        return Posed(rotation, centre, jet)


def _paper_as_vector(out: dict[str, Tensor]) -> list[Tensor]:
    """The paper's heads written as a vector jet: translation a constant term, scale a linear one.

    The scale of the rest height is left to the height jet, which the network sets as well.
    """
    shift, scale, height = out["translation"], out["scale"], out["height"]
    zero = torch.zeros_like(scale)
    p = [shift[..., 0:1], scale, zero, zero, zero, zero]
    q = [shift[..., 1:2], zero, scale, zero, zero, zero]
    h = torch.cat([height[..., :1] + shift[..., 2:3], height[..., 1:]], dim=-1)
    return [*p, *q, h]


def pose_frames(body: BodyTensors, patches: PatchTensors) -> tuple[Tensor, Tensor]:
    """Returns rotations (F, K, 3, 3) and centres [m] (F, K, 3) of the skinned patch frames, relative to the root joint.

    Body shape moves the rest centre first, then the frame follows the blended bones rigidly.
    """
    _, centre = rest_frames(body, patches)
    rotation, centre = blend_frames(
        centre, patches.weights, patches.heaviest, body.rotation, body.translation, body.quaternion
    )
    return rotation @ patches.rotation, centre


def patch_surroundings(body: BodyTensors, rotation: Tensor, centre: Tensor) -> Tensor:
    """Returns the surroundings (F, K, 75) of posed patches, each in its own frame: the offsets of the 24 joints from
    its centre, ``saturated``, and the direction of gravity.

    The code of the whole pose must be learned for every place of the body; seen from the patch,
    a bent elbow near cloth looks alike on all garments.
    """
    assert body.joints is not None
    offset = (body.joints[:, None] - centre[:, :, None]) @ rotation  # (F, K, 24, 3)
    gravity = -rotation[..., 1, :]
    return torch.cat([saturated(offset).flatten(-2), gravity], dim=-1)


def rest_frames(body: BodyTensors, patches: PatchTensors) -> tuple[Tensor, Tensor]:
    """Returns rotations (F, K, 3, 3) and centres [m] (F, K, 3) of the patch frames on the bodies in the rest pose."""
    shape = (patches.shapedirs[None] @ body.betas[:, None, :, None])[..., 0]
    centre = patches.centre[None] + shape
    return patches.rotation[None].expand(centre.shape[0], -1, -1, -1), centre


FRAME_ROWS = 4  # the first rows of posed coefficients: centre and rotation


def posed_coefficients(posed: Posed, scale: Tensor) -> Tensor:
    """Returns coefficients C [m] (F, K, 19, 3) relative to the root joint, in world axes: a vertex is
    ``sum_i w_i [1, y, basis] @ C`` over its charts.

    Row 0 is the frame's centre, rows 1-3 turn the rest position y of the vertex in the
    patch frame, rows 4-18 are the network's jets turned into the world and scaled to metres.
    """
    local = jets.full(posed.jet).unflatten(-1, (3, jets.HEIGHT_COUNT)).mT  # (F, K, 15, 3)
    turned = scale[None, :, None, None] * (local @ posed.rotation.mT)
    return torch.cat([posed.centre[..., None, :], posed.rotation.mT, turned], dim=-2)


def vertex_positions(posed: Posed, patches: PatchTensors, charts: ChartTensors) -> Tensor:
    """Returns the vertices [m] (F, V, 3) of posed patches relative to the root joint, of variant "paper" in the rest
    pose. It is the readable form, which export writes to ONNX and which tests compare the fast one with."""
    coefficients = posed_coefficients(posed, patches.scale)
    frames, count = coefficients.shape[0], charts.patch.shape[0]
    gathered = torch.index_select(coefficients.flatten(2), 1, charts.patch.reshape(-1))
    gathered = gathered.reshape(frames, count, -1, 19, 3)
    ones = torch.ones_like(charts.local[..., :1])
    row = charts.weight[..., None] * torch.cat([ones, charts.local, charts.basis], dim=-1)  # (V, 4, 19)
    return (row.reshape(1, count, 1, -1) @ gathered.reshape(frames, count, -1, 3))[..., 0, :]


def paper_vertices(posed_rest: Tensor, skin_weights: Tensor, body: BodyTensors) -> Tensor:
    """Returns the posed vertices [m] (F, V, 3) of variant "paper": ``posed_rest`` [m] (F, V, 3), which patches deform
    in the rest pose, skinned by ``skin_weights`` (V, 24)."""
    return skin_points(posed_rest, skin_weights, body.rotation, body.translation)
