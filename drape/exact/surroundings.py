"""The surroundings of a cloth for the judge's solvers: planes of the body, and two springs on every vertex."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.errors import InputError
from drape.kernels.compiled import part
from drape.kernels.elements import add, at, dot, outer, scaled, shifted, sub
from drape.kernels.problem import Problem


class Surroundings(NamedTuple):
    """Planes and springs of V vertices.

    ``point``, ``normal`` (V, 3): planes of the body, whose normals need not be of unit length. ``target`` (V, 3) with
    ``target_n_per_m`` (V,), ``band`` (V, 3) with ``band_n_per_m`` (V,): springs, the second free within the slack of
    ``drape.cloth.waistband``.
    """

    point: np.ndarray
    normal: np.ndarray
    target: np.ndarray
    target_n_per_m: np.ndarray
    band: np.ndarray
    band_n_per_m: np.ndarray


def surroundings(problem: Problem, point: np.ndarray, normal: np.ndarray) -> Surroundings:
    """The tangent planes (V, 3) alone; the springs have no stiffness."""
    dtype = problem.weight_n.dtype
    point, normal = (np.ascontiguousarray(rows, dtype=dtype) for rows in (point, normal))
    if point.shape != (len(problem.weight_n), 3) or normal.shape != point.shape:
        raise InputError(
            "contact planes",
            expected=f"points and normals ({len(problem.weight_n)}, 3)",
            got=f"{point.shape} and {normal.shape}",
            cure="Give one plane per vertex.",
        )
    nowhere, none = np.zeros_like(point), np.zeros(len(point), dtype)
    return Surroundings(point, normal, nowhere, none, nowhere, none)


@part
def outside(x, v, problem, around):
    """Energy [J], gradient [N] and symmetric Hessian [N/m] of weight, contact and springs at the point ``x`` of v."""
    k = problem.constants
    normal = at(around.normal, v)
    weight = problem.weight_n[v]
    energy = weight * x[1]
    gradient = (k.zero, weight, k.zero)
    hessian = (k.zero, k.zero, k.zero, k.zero, k.zero, k.zero)
    depth = k.gap - dot(sub(x, at(around.point, v)), normal)
    if depth > k.zero:
        stiffness = problem.contact_n_per_m[v]
        energy += k.half * stiffness * depth * depth
        gradient = add(gradient, scaled(-stiffness * depth, normal))
        hessian = outer(hessian, stiffness, normal)
    spring = around.target_n_per_m[v]
    if spring > k.zero:
        way = sub(x, at(around.target, v))
        energy += k.half * spring * dot(way, way)
        gradient = add(gradient, scaled(spring, way))
        hessian = shifted(hessian, spring)
    spring = around.band_n_per_m[v]
    if spring > k.zero:
        way = sub(x, at(around.band, v))
        length = np.sqrt(dot(way, way))
        if length > k.slack:
            past = length - k.slack
            energy += k.half * spring * past * past
            gradient = add(gradient, scaled(spring * past / length, way))
            hessian = outer(shifted(hessian, spring * past / length), spring * k.slack / length**3, way)
    return energy, gradient, hessian
