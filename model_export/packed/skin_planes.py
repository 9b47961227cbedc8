"""Body proximity of the patches of the packed graph: ``drape.contact.proximity`` with bodies mixed."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from drape.arrays import count_of
from drape.contact.field import attend, queries, surface
from drape.contact.projection import REGION_BIAS_M2, REGION_COUNT
from drape.contact.proximity import GAP_M, HELD_M, SOFT_M, UNIT_M, attend_others, from_halves, plane_share
from drape.contact.samples import CLUSTER_SIZE, REGION_SIZE, region_centres
from drape.contact.skin import skin_table
from drape.garment.consensus import STRAIN_POINTS, strain_points
from drape.geometry import jets
from drape.graph.packed_inputs import ShapedSkins, StoredProximity
from model_export.packed.kinematics import PatchFrames
from model_export.packed.operators import WithTables, softsign

PLACES = 2 * STRAIN_POINTS  # each point of a patch before its own part of the body, then before other parts


def posed_skins(skins: ShapedSkins, rotation: Tensor, translation: Tensor) -> Tensor:
    """Returns the posed samples (B, R, 12, 8) of the bodies' skin as ``drape.contact.samples.sample_table`` has them.

    ``rotation`` (B, 24, 3, 3) and ``translation`` (B, 24, 3) [m] are those of the bones.
    """
    return skin_table(torch.index_select(skins.rows, 0, skins.shape), skins.bones, rotation, translation)


@dataclass(frozen=True)
class NearPlanes:
    """The body's tangent planes near the seven points of P patches, in the frames of the patches. Each point has two:
    one of the part of the body that the patch lies on, and one of the body's other parts.

    Columns are sorted by axis, then part, then point. ``offset`` (P, 14) + the sum over axes of ``normal`` (P, 42) x
    place [patch scales] is the depth [cm] of a point below the height at which it feels the plane. ``share`` (P, 14),
    from 0 to 1, says whether there is a plane. ``pull`` (P, 14) is the share times the factor that makes ``normal`` a
    unit normal.
    """

    normal: Tensor
    offset: Tensor
    share: Tensor
    pull: Tensor


class Contact(WithTables):
    """A module without weights: body proximity (``drape.contact.proximity``) in the frames of the patches, where a pass
    is a few products.

    The planes are looked up in the world, once; jets move points along the axes of their patch.
    """

    def __init__(self) -> None:
        super().__init__(_skin_plane_tables())

    def places(self, lists: StoredProximity) -> Tensor:
        """Returns the rest places (P, 42) [patch scales] of the seven points of each patch, in its frame: twice, for
        the two parts of the body."""
        return lists.place.reshape(-1, 3 * STRAIN_POINTS) @ self.twice

    def points(self, jet: Tensor, places: Tensor) -> Tensor:
        """Returns ``places`` (P, 42) [patch scales] moved by ``jet`` (P, 27), the change of the rest jets."""
        return torch.addmm(places, jet, self.point_terms)

    def near(
        self, points: Tensor, skin: Tensor, lists: StoredProximity, patch_body: Tensor, frames: PatchFrames
    ) -> NearPlanes:
        """Returns the two planes near each of the seven points of P patches, ``points`` (P, 42) [patch scales], in the
        columns of ``NearPlanes``. ``skin`` (B, R, 12, 8) are the posed samples of B bodies, ``patch_body`` (P,) says on
        which body each patch is, and ``lists`` has the samples near each patch at rest."""
        world = (frames.rotation * frames.scale) @ points.reshape(-1, 3, PLACES) + frames.centre
        middle = torch.addmm(self.middle_last, world.reshape(-1, 3 * PLACES), self.middle_terms)
        means = near_means(world[:, :, :STRAIN_POINTS].mT, middle, skin, lists, patch_body)
        nearest = surface(world, means)
        share = plane_share(nearest)
        unit = frames.scale.reshape(-1, 1) * (-1.0 / UNIT_M)
        normal = (frames.rotation.mT @ nearest.normal).reshape(-1, 3 * PLACES) * unit
        offset = (GAP_M - nearest.distance) * (1.0 / UNIT_M) - (normal * points) @ self.axis_sums
        return NearPlanes(normal, offset, share, share / unit)

    def forward(self, points: Tensor, near: NearPlanes) -> list[Tensor]:
        """Returns two inputs of a correction, both between -1 and 1: how near the planes are to ``points`` (P, 14), and
        the softened force (P, 27) with which they push the jets."""
        missing = torch.addmm(near.offset, near.normal * points, self.axis_sums)
        pull = (near.pull * torch.relu(missing)) @ self.axis_copies
        # A quarter of the force, softened, which takes four times its argument.
        return [near.share * torch.tanh(missing), softsign((pull * near.normal) @ self.point_terms.mT)]

    def held(self, before: Tensor, after: Tensor, near: NearPlanes) -> Tensor:
        """Returns the share (P, 1), from 0 to 1, of a correction that each patch takes: ``held_share``. Its points go
        from ``before`` to ``after`` (P, 42) [patch scales]."""
        missing = torch.addmm(near.offset, near.normal * before, self.axis_sums)
        deeper = near.share * ((near.normal * (after - before)) @ self.axis_sums)
        room = torch.relu((GAP_M + HELD_M) / UNIT_M - missing) + SOFT_M / UNIT_M
        return torch.amin(room / torch.maximum(deeper + SOFT_M / UNIT_M, room), dim=-1, keepdim=True)


def _skin_plane_tables() -> dict[str, Tensor]:
    """Returns the constant matrices that ``Contact`` multiplies with, by the names of its buffers."""
    basis = torch.from_numpy(jets.basis(strain_points(), jets.HEIGHT_ORDER)).float()  # (7, 15)
    terms = torch.zeros(jets.JET_COUNT, 3, 2, STRAIN_POINTS)
    first = 0
    for axis, count in enumerate((jets.IN_PLANE_COUNT, jets.IN_PLANE_COUNT, jets.HEIGHT_COUNT)):
        terms[first : first + count, axis] = basis.T[:count, None]
        first += count
    axes = torch.eye(STRAIN_POINTS).repeat(1, 2)
    own = torch.tensor([1.0 / STRAIN_POINTS] * STRAIN_POINTS + [0.0] * STRAIN_POINTS)[:, None]
    return {
        "point_terms": terms.reshape(jets.JET_COUNT, -1),
        "twice": torch.kron(torch.eye(3), axes),
        "axis_sums": torch.eye(PLACES).repeat(3, 1),
        "axis_copies": torch.eye(PLACES).repeat(1, 3),
        "middle_terms": torch.kron(torch.eye(3, 4), own),
        "middle_last": torch.tensor([[0.0, 0.0, 0.0, 1.0]]),
    }


def near_means(places: Tensor, middle: Tensor, skin: Tensor, lists: StoredProximity, patch_body: Tensor) -> Tensor:
    """Returns the means (P, 8, 14) of the samples ``skin`` (B, R, 12, 8), their eight numbers first, around ``places``
    [m] (P, 7, 3) as ``drape.contact.field.attend`` weights them: at the seven places those of the part of the body that
    the patch lies on, then those of the other parts.

    ``middle`` (P, 4) is the mean place [m] of each patch, and 1; ``patch_body`` (P,) says on which body it is.
    """
    bodies, regions = skin.shape[0], skin.shape[1]
    query = queries(places.mT).mT
    body = patch_body.to(torch.int64)
    clusters = skin.reshape(-1, 8 * CLUSTER_SIZE)
    stride = count_of(skin[0, :, 0, 0], torch.int64)  # regions of a body
    first = body * (stride * (REGION_SIZE // CLUSTER_SIZE))
    own = torch.index_select(clusters, 0, (lists.cluster.to(torch.int64) + first[:, None]).reshape(-1))
    own_means = attend(query, own.reshape(-1, lists.bias.shape[1], 8), lists.bias)

    region = region_centres(skin)
    rows = torch.cat([-2.0 * region, (region * region).sum(dim=-1, keepdim=True)], dim=-1).reshape(bodies, -1)
    around = torch.index_select(rows, 0, body).reshape(-1, regions, 4)
    squared = (around @ middle[:, :, None]).reshape(-1, regions)
    bias = lists.region.reshape(-1, regions).to(places.dtype)
    top = torch.topk(REGION_BIAS_M2 * bias - squared, REGION_COUNT, dim=-1, sorted=False)[1]
    table = torch.index_select(skin.reshape(-1, 8 * REGION_SIZE), 0, (top + (stride * body)[:, None]).reshape(-1))
    # 0, 1, 2, ... counted out: the number of patches would be read off an index that a call of one garment lacks.
    patch = stride * (torch.cumsum(torch.ones_like(body), dim=0) - 1)
    row = (top + patch[:, None]).reshape(-1)
    other = torch.index_select(lists.other.reshape(-1, REGION_SIZE // 2), 0, row).to(places.dtype)
    count = REGION_COUNT * REGION_SIZE
    other_means = attend_others(query, table.reshape(-1, count, 8), from_halves(other).reshape(-1, count))
    return torch.cat([own_means, other_means], dim=1).mT
