"""One garment on posed bodies, and its drape of least energy in the variables of a form of patch."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from benchmarks.measure.judged import Judged
from benchmarks.papers.held_out import judged
from benchmarks.papers.representation_minimise import Minimum, minimise
from benchmarks.papers.representation_space import Charts, PatchSpace, Representation, VertexSpace, block_scaling
from drape.body.model import BodyModel
from drape.cloth import energies
from drape.cloth.material import Material
from drape.garment.cache import Garment
from drape.garment.fitting import RestGarment
from drape.garment.skin import BodyBinding
from drape.geometry.rotations import matrix_to_quaternion
from drape.geometry.skinning import blend_frames


@dataclass(frozen=True, eq=False)
class Bench:
    """One garment on F posed bodies: what all forms of patch share."""

    judge: Judged
    rest: RestGarment
    bones: tuple[np.ndarray, np.ndarray]

    @classmethod
    def of(cls, garment: Garment, body: BodyModel, poses: np.ndarray, cloth: Material) -> Bench:
        """The bench of ``garment`` in ``cloth`` on ``body`` at ``poses`` (F, 24, 3) [rad]."""
        binding = BodyBinding(garment.skin_weights.astype(np.float64), garment.shapedirs.astype(np.float64))
        rest = RestGarment(garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64), binding, body)
        return cls(judged(garment, body, poses, cloth), rest, body.bones(poses))


class Objective:
    """The energy of one frame in the variables of a space."""

    def __init__(self, bench: Bench, frame: int, space: PatchSpace | VertexSpace) -> None:
        judge = bench.judge
        self._space, self._contact, self._material = space, judge.cloth.contact, judge.cloth.material
        self._cloth, self._height_m = judge.cloth.mesh.like(torch.zeros(1)), float(judge.height_m[frame])
        self._body = judge.body_vertices[frame][None], judge.body_normals[frame][None]
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
        (gradient,) = torch.autograd.grad(total, moving)
        return float(total.detach()), gradient


@dataclass(frozen=True, eq=False)
class Drapes:
    """F frames minimised in ``spaces``: ``vertices`` [m] (F, V, 3), what was reached, and CPU ``seconds``."""

    spaces: Sequence[PatchSpace | VertexSpace]
    vertices: np.ndarray
    minima: Sequence[Minimum]
    seconds: float


def frame_spaces(bench: Bench, form: Representation, found: Charts) -> list[PatchSpace]:
    """What ``form`` can make of each frame, every patch scaled by itself."""
    scaling = block_scaling(form, found)
    if not form.skinned:
        return [PatchSpace(form, found, *frame, scaling) for frame in posed_frames(bench, found)]
    rotations, translations = bench.bones
    weights, frames = bench.rest.binding.weights, len(rotations)
    matrices = (weights @ rotations.reshape(frames, -1, 9)).reshape(frames, -1, 3, 3)
    skins = zip(matrices, weights @ translations, strict=True)
    return [PatchSpace(form, found, found.rotation, found.centre, scaling, skin=skin) for skin in skins]


def posed_frames(bench: Bench, found: Charts) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rotation (K, 3, 3) and centre (K, 3) [m] of the patches in each frame, moved rigidly by the bones."""
    rotations, translations = bench.bones
    rest = np.broadcast_to(found.centre, (len(rotations), *found.centre.shape))
    heaviest, quaternions = found.bones.argmax(axis=1), matrix_to_quaternion(rotations)
    rotation, centre = blend_frames(rest, found.bones, heaviest, rotations, translations, quaternions)
    return list(zip(rotation @ found.rotation, centre, strict=True))


def drape(bench: Bench, spaces: Sequence[PatchSpace | VertexSpace], *, step_limit: int) -> Drapes:
    """Every frame's energy minimised in its space, from zero, which is the skinned start."""
    began = time.process_time()
    minima = [
        minimise(Objective(bench, frame, space), torch.zeros(space.size), step_limit=step_limit)
        for frame, space in enumerate(spaces)
    ]
    seconds = time.process_time() - began
    with torch.no_grad():
        vertices = [space.positions(found.z).double().numpy() for space, found in zip(spaces, minima, strict=True)]
    return Drapes(spaces, np.stack(vertices), minima, seconds)
