"""One garment on posed bodies, and its drape of least energy in the variables of a form of patch."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from benchmarks.network import Draped
from benchmarks.representation_consensus import Refit
from benchmarks.representation_minimise import Minimum, minimise
from benchmarks.representation_space import Charts, PatchSpace, Representation, VertexSpace, block_scaling
from drape.body.model import BodyModel
from drape.cloth import energies, metrics
from drape.cloth.contact import BodyContact, push_out
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.garment.cache import Garment
from drape.garment.disagreement import widest_angles
from drape.garment.fitting import RestGarment
from drape.garment.skin import Hang
from drape.geometry import jets
from drape.geometry.rotations import matrix_to_quaternion
from drape.geometry.skinning import blend_frames, skin_points


@dataclass(frozen=True, eq=False)
class Bench:
    """One garment on F posed bodies: what all forms of patch share."""

    garment: Garment
    rest: RestGarment
    cloth: ClothMesh
    material: Material
    contact: BodyContact
    bones: tuple[np.ndarray, np.ndarray]
    body_vertices: np.ndarray
    body_normals: np.ndarray
    skinned: np.ndarray
    pushed: np.ndarray
    height_m: np.ndarray

    @property
    def frame_count(self) -> int:
        return len(self.skinned)


class Objective:
    """The energy of one frame in the variables of a space, and ``agree_j_m2`` times the charts' disagreement."""

    def __init__(self, bench: Bench, frame: int, space: PatchSpace | VertexSpace, *, agree_j_m2: float = 0.0) -> None:
        self._space, self._agree = space, agree_j_m2
        self._cloth, self._material = bench.cloth.like(torch.zeros(1)), bench.material
        self._contact, self._height_m = bench.contact, float(bench.height_m[frame])
        self._body = bench.body_vertices[frame][None], bench.body_normals[frame][None]
        self._planes = None

    def refresh(self, z: Tensor) -> None:
        with torch.no_grad():
            points = self._space.positions(z)
        self._planes = self._contact.planes(points[None].double().numpy(), *self._body).like(points)

    def value_and_gradient(self, z: Tensor) -> tuple[float, Tensor]:
        assert self._planes is not None
        moving = z.detach().requires_grad_()
        points = self._space.positions(moving)
        distance = self._planes.distance(points)[0]
        parts = energies.total(points, self._cloth, self._material, distance=distance, height_m=self._height_m)
        total = torch.stack([part.sum() for part in parts.values()]).sum()
        if self._agree and isinstance(self._space, PatchSpace):
            total = total + self._agree * self._space.disagreement(moving)
        (gradient,) = torch.autograd.grad(total, moving)
        return float(total.detach()), gradient


@dataclass(frozen=True)
class ChartFigures:
    """How overlapping charts disagree, as drape.garment.disagreement counts it; NaN without charts.

    ``gap_p99_mm`` 99th percentile [mm] of the distances from what one says of a vertex to the blended vertex,
    ``gap_rms_mm`` their root mean square by area and weight [mm], ``normal_p99_deg`` 99th percentile [deg] of the
    largest angle between two normals of a vertex, NaN for a skinned form.
    """

    gap_p99_mm: float = math.nan
    gap_rms_mm: float = math.nan
    normal_p99_deg: float = math.nan


@dataclass(frozen=True, eq=False)
class Drapes:
    """F frames in ``spaces``: ``vertices`` [m] (F, V, 3), their variables ``z``, what was reached where they were
    minimised, CPU ``seconds``, and what the charts say."""

    spaces: Sequence[PatchSpace | VertexSpace]
    z: Sequence[Tensor]
    vertices: np.ndarray
    charts: ChartFigures
    minima: Sequence[Minimum] = ()
    seconds: float = math.nan


def open_bench(garment: Garment, body: BodyModel, poses: np.ndarray, cloth_material: Material) -> Bench:
    """The bench of ``garment`` on ``body`` in ``poses`` (F, 24, 3) [rad]."""
    hang = Hang(garment.skin_weights.astype(np.float64), garment.shapedirs.astype(np.float64))
    rest = RestGarment(garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64), hang, body)
    cloth = ClothMesh.from_rest(rest.vertices, rest.faces)
    contact = BodyContact(body.faces, body.vertex_count)
    rotations, translations = body.bones(poses)
    still = np.broadcast_to(rest.vertices, (len(poses), *rest.vertices.shape))
    skinned = skin_points(still, rest.hang.weights, rotations, translations)
    skin = body.posed_vertices(poses)
    normals = np.asarray(contact.normals(skin))
    return Bench(
        garment=garment,
        rest=rest,
        cloth=cloth,
        material=cloth_material,
        contact=contact,
        bones=(rotations, translations),
        body_vertices=skin,
        body_normals=normals,
        skinned=skinned,
        pushed=push_out(skinned, skin, normals),
        height_m=metrics.mean_height(skinned, cloth),
    )


def frame_spaces(bench: Bench, form: Representation, found: Charts, *, refit: Refit | None = None) -> list[PatchSpace]:
    """What ``form`` can make of each frame, every patch scaled by itself; ``refit`` for a form that is not skinned."""
    scaling = block_scaling(form, found)
    if not form.skinned:
        return [PatchSpace(form, found, *frame, scaling, refit=refit) for frame in posed_frames(bench, found)]
    rotations, translations = bench.bones
    weights = bench.rest.hang.weights
    matrices = (weights @ rotations.reshape(bench.frame_count, -1, 9)).reshape(bench.frame_count, -1, 3, 3)
    skins = zip(matrices, weights @ translations, strict=True)
    return [PatchSpace(form, found, found.rotation, found.centre, scaling, skin=skin) for skin in skins]


def posed_frames(bench: Bench, found: Charts) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rotation (K, 3, 3) and centre (K, 3) [m] of the patches in each frame, moved rigidly by the bones."""
    rotations, translations = bench.bones
    rest = np.broadcast_to(found.centre, (bench.frame_count, *found.centre.shape))
    heaviest, quaternions = found.bones.argmax(axis=1), matrix_to_quaternion(rotations)
    rotation, centre = blend_frames(rest, found.bones, heaviest, rotations, translations, quaternions)
    return list(zip(rotation @ found.rotation, centre, strict=True))


def drape(
    bench: Bench,
    spaces: Sequence[PatchSpace | VertexSpace],
    *,
    starts: Sequence[Tensor] | None = None,
    step_limit: int,
    agree_j_m2: float = 0.0,
) -> Drapes:
    """Every frame's energy minimised in its space, from ``starts`` or from zero, which is the skinned start."""
    began = time.process_time()
    minima = []
    for frame, space in enumerate(spaces):
        objective = Objective(bench, frame, space, agree_j_m2=agree_j_m2)
        start = torch.zeros(space.size) if starts is None else starts[frame]
        minima.append(minimise(objective, start, step_limit=step_limit))
    seconds = time.process_time() - began
    return replace(posed(spaces, [minimum.z for minimum in minima]), minima=minima, seconds=seconds)


def posed(spaces: Sequence[PatchSpace | VertexSpace], z: Sequence[Tensor]) -> Drapes:
    """The drapes of given variables."""
    with torch.no_grad():
        vertices = [space.positions(own).double().numpy() for space, own in zip(spaces, z, strict=True)]
    patches = [(space, own) for space, own in zip(spaces, z, strict=True) if isinstance(space, PatchSpace)]
    return Drapes(spaces, z, np.stack(vertices), chart_figures(patches) if patches else ChartFigures())


def after(drapes: Drapes, refit: Refit) -> Drapes:
    """The same numbers of rigid frames after ``refit``."""
    spaces = [space.with_refit(refit) for space in drapes.spaces if isinstance(space, PatchSpace)]
    return posed(spaces, drapes.z)


def network_drapes(bench: Bench, form: Representation, found: Charts, draped: Draped) -> Drapes:
    """What a network made of the frames, in the spaces of ``form`` (rigid frames, in-plane order 2)."""
    scaling, plane = block_scaling(form, found), 2 * jets.IN_PLANE_COUNT
    centre = draped.centre.astype(np.float64) + draped.root[:, None]
    frames = zip(draped.rotation.astype(np.float64), centre, strict=True)
    spaces = [PatchSpace(form, found, *frame, scaling) for frame in frames]
    # A form's numbers begin with the height's.
    numbers = torch.from_numpy(np.concatenate([draped.jet[..., plane:], draped.jet[..., :plane]], axis=-1))
    return posed(spaces, [scaling.variables(own) for own in numbers.float()])


def chart_figures(drapes: Sequence[tuple[PatchSpace, Tensor]]) -> ChartFigures:
    """Disagreement over frames, each a space and its variables."""
    gaps, angles, squares = [], [], []
    for space, z in drapes:
        with torch.no_grad():
            rows = space.rows(z)
        found, gap = space.charts, space.gaps_m(rows)
        gaps.append(gap[found.heard])
        squares.append(float(np.sum(found.share[:, None] * found.weight * gap**2)))
        if space.skin is None:
            overlap = found.heard.any(axis=1)
            angles.append(widest_angles(space.normals(rows)[None, overlap], found.heard[overlap])[0])
    return ChartFigures(
        gap_p99_mm=1e3 * float(np.percentile(np.concatenate(gaps), 99.0)),
        gap_rms_mm=1e3 * math.sqrt(np.mean(squares)),
        normal_p99_deg=math.degrees(float(np.percentile(np.concatenate(angles), 99.0))) if angles else math.nan,
    )


def static_parts(bench: Bench, vertices: np.ndarray) -> dict[str, np.ndarray]:
    """Energies [J] (F,) by part of ``vertices`` [m] (F, V, 3), in float64, contact planes looked up anew."""
    return metrics.static_parts(
        vertices, bench.cloth, bench.material, bench.contact, bench.body_vertices, height_m=bench.height_m
    )


def total_j(bench: Bench, vertices: np.ndarray) -> float:
    """Mean energy [J] of the frames."""
    return float(np.stack(list(static_parts(bench, vertices).values())).sum(axis=0).mean())
