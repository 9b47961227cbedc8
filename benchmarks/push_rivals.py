"""What the push-out was chosen from: per-bone distance grids, capsules, and body vertices near a vertex at rest.

Each is a torch module, relative to the root as the graphs are: vertices (1, V, 3), bones (1, 24, 3, 3) and
(1, 24, 3) in, vertices out, so that quality and time are those of one and the same program.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor, nn

from drape.body.model import BodyModel
from drape.body.skeleton import BONE_ENDS, JOINT_COUNT
from drape.geometry import closest, meshes
from drape.push.skin import Skin

CELLS = 32  # of a grid along each axis: 1 to 2.5 cm
MARGIN_M = 0.05
FREE_M = 0.05  # what a grid says where the nearest skin belongs to another bone
OWNED = 0.4  # weight from which skin belongs to a bone
CANDIDATES = 24
PASSES = 2
RADIUS_PERCENTILE = 80.0


class DistanceGrids(nn.Module):
    """A grid of signed distance and normal per bone, sampled by GridSample; out of the bone nearest to the surface."""

    grids: Tensor
    low: Tensor
    span: Tensor

    def __init__(self, body: BodyModel, clearance_m: float, *, cells: int = CELLS) -> None:
        super().__init__()
        self.clearance_m = clearance_m
        rest, normals = body.v_template, meshes.vertex_normals(body.v_template, body.faces)
        tree = KDTree(rest)
        grids, lows, spans = [], [], []
        for bone in range(JOINT_COUNT):
            members = rest[body.weights[:, bone] >= OWNED]
            members = members if len(members) else body.joints_template[bone : bone + 1]
            low, high = members.min(axis=0) - MARGIN_M, members.max(axis=0) + MARGIN_M
            axes = [np.linspace(low[i], high[i], cells) for i in range(3)]
            points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
            distance = closest.signed_distance(points, rest, body.faces)
            nearest = tree.query(points)[1]
            distance = np.where(body.weights[nearest, bone] >= OWNED, distance, FREE_M)
            values = np.concatenate([distance[:, None], normals[nearest]], axis=1).reshape(cells, cells, cells, 4)
            # GridSample's last axis is its first coordinate.
            grids.append(values.transpose(3, 2, 1, 0))
            lows.append(low)
            spans.append(high - low)
        self.register_buffer("grids", torch.tensor(np.stack(grids), dtype=torch.float32))
        self.register_buffer("low", torch.tensor(np.stack(lows), dtype=torch.float32))
        self.register_buffer("span", torch.tensor(np.stack(spans), dtype=torch.float32))

    def forward(self, vertices: Tensor, bone_rotation: Tensor, bone_translation: Tensor) -> Tensor:
        x = vertices[0]
        for _ in range(PASSES):
            local = (x[None] - bone_translation[0][:, None]) @ bone_rotation[0]  # (24, V, 3): R^T (x - t)
            place = 2.0 * (local - self.low[:, None]) / self.span[:, None] - 1.0
            inside = (place.abs() <= 1.0).all(dim=-1)
            sampled = nn.functional.grid_sample(
                self.grids, place[:, :, None, None], mode="bilinear", padding_mode="border", align_corners=True
            )[:, :, :, 0, 0]  # (24, 4, V)
            distance = torch.where(inside, sampled[:, 0], torch.full_like(sampled[:, 0], FREE_M))
            nearest, bone = distance.min(dim=0)
            turned = bone_rotation[0] @ sampled[:, 1:]  # (24, 3, V)
            normal = turned.permute(2, 0, 1)[torch.arange(len(x)), bone]
            normal = normal / normal.norm(dim=-1, keepdim=True).clamp(min=1e-6)
            x = x + (self.clearance_m - nearest).clamp(min=0.0)[:, None] * normal
        return x[None]


class Capsules(nn.Module):
    """A capsule per bone, its radius that of the skin about the bone; out of the one a vertex lies deepest in."""

    start: Tensor
    axis: Tensor
    radius: Tensor

    def __init__(self, body: BodyModel, clearance_m: float) -> None:
        super().__init__()
        self.clearance_m = clearance_m
        joints, bone_of = body.joints_template, body.weights.argmax(axis=1)
        starts, axes, radii = [], [], []
        for bone, end in enumerate(BONE_ENDS):
            start = joints[bone]
            axis = joints[end] - start if end >= 0 else np.zeros(3)
            offset = body.v_template[bone_of == bone] - start
            along = np.clip(offset @ axis / max(float(axis @ axis), 1e-12), 0.0, 1.0)
            away = np.linalg.norm(offset - along[:, None] * axis, axis=1)
            starts.append(start)
            axes.append(axis)
            radii.append(np.percentile(away, RADIUS_PERCENTILE) if len(away) else 0.0)
        self.register_buffer("start", torch.tensor(np.stack(starts), dtype=torch.float32))
        self.register_buffer("axis", torch.tensor(np.stack(axes), dtype=torch.float32))
        self.register_buffer("radius", torch.tensor(np.array(radii), dtype=torch.float32))

    def forward(self, vertices: Tensor, bone_rotation: Tensor, bone_translation: Tensor) -> Tensor:
        x = vertices[0]
        start = (bone_rotation[0] @ self.start[..., None])[..., 0] + bone_translation[0]
        axis = (bone_rotation[0] @ self.axis[..., None])[..., 0]
        square = (axis * axis).sum(dim=-1).clamp(min=1e-12)
        for _ in range(PASSES):
            offset = x[:, None] - start
            along = ((offset * axis).sum(dim=-1) / square).clamp(0.0, 1.0)
            away = offset - along[..., None] * axis
            reach = away.norm(dim=-1).clamp(min=1e-6)
            distance, bone = (reach - self.radius).min(dim=1)
            row = torch.arange(len(x))
            normal = away[row, bone] / reach[row, bone][:, None]
            x = x + (self.clearance_m - distance).clamp(min=0.0)[:, None] * normal
        return x[None]


class RestCandidates(nn.Module):
    """The samples of the skin nearest to each vertex at rest; out of the plane of the nearest of them in the pose."""

    index: Tensor
    rows: Tensor

    def __init__(self, skin: Skin, rows: np.ndarray, rest: np.ndarray, clearance_m: float) -> None:
        super().__init__()
        self.clearance_m = clearance_m
        index = KDTree(skin.point).query(rest, k=CANDIDATES)[1]
        self.register_buffer("index", torch.tensor(index))
        self.register_buffer("rows", torch.tensor(rows, dtype=torch.float32))  # (3 S, 96)

    def forward(self, vertices: Tensor, bone_rotation: Tensor, bone_translation: Tensor) -> Tensor:
        bones = torch.cat([bone_rotation[0].mT, bone_translation[0][:, None]], dim=1)  # (24, 4, 3)
        point, first, second = (self.rows @ bones.reshape(4 * JOINT_COUNT, 3)).reshape(3, -1, 3)
        normal = torch.linalg.cross(first, second)
        normal = normal / normal.norm(dim=-1, keepdim=True).clamp(min=1e-6)
        near, facing = point[self.index], normal[self.index]  # (V, 24, 3)
        x = vertices[0]
        row = torch.arange(len(x))
        for _ in range(PASSES):
            offset = x[:, None] - near
            chosen = (offset * offset).sum(dim=-1).argmin(dim=1)
            out = facing[row, chosen]
            missing = self.clearance_m - (offset[row, chosen] * out).sum(dim=-1)
            x = x + missing.clamp(min=0.0)[:, None] * out
        return x[None]
