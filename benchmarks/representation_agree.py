"""What it costs that overlapping charts agree: the energy under heavier and heavier penalties on their gaps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import torch

from benchmarks.representation_consensus import Refit
from benchmarks.representation_drape import Bench, Drapes, drape, posed_frames
from benchmarks.representation_scaling import CoupledScaling, Sparse, agreement_hessian, energy_hessian, moves
from benchmarks.representation_space import Charts, PatchSpace, Representation, embedding
from drape.geometry import meshes


def drape_agreeing(
    bench: Bench,
    form: Representation,
    found: Charts,
    weights: Sequence[float],
    *,
    step_limit: int,
    refit: Refit | None = None,
) -> Iterator[tuple[float, Drapes]]:
    """Each of ``weights`` [J/m^2 per m^2], ascending, and the drapes under it.

    ``form`` is rigid and without turns. The energy gets ``weight * area * PatchSpace.disagreement`` added, which is
    how training weighs its own; the first drape starts from skinning, every other from the one before. With ``refit``
    both are taken after it.
    """
    area = float(bench.cloth.vertex_area.sum())
    frames = posed_frames(bench, found)
    hessians = [_hessians(bench, form, found, n, rotation) for n, (rotation, _) in enumerate(frames)]
    numbers = [torch.zeros(found.patch_count, form.number_count) for _ in frames]
    for weight in weights:
        spaces, starts = [], []
        for (energy, agreement), frame, own in zip(hessians, frames, numbers, strict=True):
            scaling = CoupledScaling(Sparse(energy + weight * area * agreement), found.patch_count)
            spaces.append(PatchSpace(form, found, *frame, scaling, refit=refit))
            starts.append(scaling.variables(own))
        drapes = drape(bench, spaces, starts=starts, step_limit=step_limit, agree_j_m2=weight * area)
        numbers = [space.scaling.numbers(m.z) for space, m in zip(spaces, drapes.minima, strict=True)]
        yield weight, drapes


def _hessians(
    bench: Bench, form: Representation, found: Charts, frame: int, rotation: np.ndarray
) -> tuple[Sparse, Sparse]:
    """Approximate Hessian of the energy [J] and that of the disagreement [m^2] in the numbers of one frame."""
    said = moves(found.shapes, embedding(form, found.rest_jet), rotation)
    blended = moves(Sparse(found.mean @ found.shapes), embedding(form, found.rest_jet), rotation)
    normals = np.asarray(meshes.vertex_normals(bench.skinned[frame], bench.rest.faces))
    return (
        energy_hessian(blended, normals, found.along, found.across),
        agreement_hessian(said, blended, found.weight, found.share),
    )


def gain_at_gap(curve: Sequence[tuple[float, float]], gap_mm: float) -> float | None:
    """The gain where the gap is ``gap_mm``, between the points (gap [mm], gain) of ``curve``; None outside them.

    Linear in the logarithm of the gap.
    """
    points = sorted(curve)
    gaps = [math.log(gap) for gap, _ in points]
    if not points or not gaps[0] <= math.log(gap_mm) <= gaps[-1]:
        return None
    return float(np.interp(math.log(gap_mm), gaps, [gain for _, gain in points]))
