"""The inputs of the packed graph in groups, and what posing its patches gives."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from model_export.packed_contact import Skins


@dataclass(frozen=True)
class Bodies:
    """Inputs of ``PackedGraph`` per body."""

    joint_quaternion: Tensor
    joint_rest: Tensor
    betas: Tensor
    dynamic_code: Tensor | None = None
    skins: Skins | None = None


@dataclass(frozen=True)
class Patches:
    """Inputs of ``PackedGraph`` per stored patch, less the prefix of their names."""

    first: Tensor
    weights: Tensor
    rotation: Tensor
    scale: Tensor
    centre: Tensor
    shapedirs: Tensor


@dataclass(frozen=True)
class Charts:
    """Inputs of ``PackedGraph`` by which charts agree, gathered for its patches."""

    columns: Tensor  # (P, 9, 56)
    fit: Tensor  # (P, 56, 21)
    rest: Tensor  # (P, 63): 21 of each coordinate
    tangent: Tensor  # (P, 42): by u at x, y, z of seven points, then by v
    unit: Tensor  # (P, 3, 7): the upper triangles
    anchor_charts: Tensor
    member_anchor: Tensor


@dataclass(frozen=True)
class PosedPatches:
    """Posed jets (P, 3, 18), jets in the frames (P, 27 or 45), frames (P, 3, 3) and (P, 3, 1), bones of the bodies.

    ``skin`` (B, R, 12, 8) of the bodies, where patches feel it.
    ``passes``: jets (P, 27) before the first correction and after each, where a closing fit follows them.
    """

    coefficients: Tensor
    jet: Tensor
    rotation: Tensor
    centre: Tensor
    bone_rotation: Tensor
    bone_translation: Tensor
    skin: Tensor | None = None
    passes: tuple[Tensor, ...] = ()
