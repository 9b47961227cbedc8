"""Energy, gradient and sweeps of a cloth, compiled; energies are summed in float64.

Vertex block descent: Chen et al. 2024, "Vertex Block Descent", ACM TOG 43(4). One vertex after the other goes to the
minimum of its own quadratic model.
"""

from __future__ import annotations

import numpy as np

from drape.exact.surroundings import outside
from drape.kernels.compiled import kernel, part
from drape.kernels.elements import (
    add,
    add_to,
    at,
    columns,
    corner_force,
    corner_stiffness,
    dot,
    fold,
    fold_gradient,
    hinge_corner,
    mix,
    outer,
    scaled,
    shifted,
    solved,
    stress,
    sub,
)

TRIES = 6  # halvings of a guarded vertex's step before it stays

# --- energy and gradient ---------------------------------------------------------------------------------------------


@kernel
def energy_and_gradient(x, problem, around, gradient):
    """Energy [J] at ``x`` [m] (V, 3); its gradient [N] is written to ``gradient`` (V, 3)."""
    return _membrane_and_outside(x, problem, around, gradient) + _hinge_energy(x, problem, gradient)


@part
def _membrane_and_outside(x, problem, around, gradient):
    k, t = problem.constants, problem.triangles
    total = 0.0
    for v in range(len(x)):
        energy, g, _ = outside(at(x, v), v, problem, around)
        gradient[v, 0], gradient[v, 1], gradient[v, 2] = g[0], g[1], g[2]
        total += energy
    for f in range(len(t.corner)):
        i, j, l = t.corner[f, 0], t.corner[f, 1], t.corner[f, 2]
        first, second = sub(at(x, j), at(x, i)), sub(at(x, l), at(x, i))
        a, b, c, d = t.inverse[f, 0], t.inverse[f, 1], t.inverse[f, 2], t.inverse[f, 3]
        along, across = mix(a, first, b, second), mix(c, first, d, second)
        pp, tt, pt, energy = stress(along, across, t.area[f], k)
        total += energy
        by_along, by_across = mix(pp, along, pt, across), mix(pt, along, tt, across)
        by_first, by_second = mix(a, by_along, c, by_across), mix(b, by_along, d, by_across)
        add_to(gradient, j, by_first)
        add_to(gradient, l, by_second)
        add_to(gradient, i, scaled(-k.one, add(by_first, by_second)))
    return total


@part
def _hinge_energy(x, problem, gradient):
    k, hinges = problem.constants, problem.hinges
    total = 0.0
    for h in range(len(hinges.corner)):
        corner = hinges.corner[h]
        points = (at(x, corner[0]), at(x, corner[1]), at(x, corner[2]), at(x, corner[3]))
        turned, vectors, scalars = fold(points, hinges.cosine[h], hinges.sine[h], k)
        stiffness = hinges.stiffness[h]
        total += stiffness * turned
        by_corner = fold_gradient(vectors, scalars, hinges.cosine[h], hinges.sine[h], k)
        add_to(gradient, corner[0], scaled(stiffness, by_corner[0]))
        add_to(gradient, corner[1], scaled(stiffness, by_corner[1]))
        add_to(gradient, corner[2], scaled(stiffness, by_corner[2]))
        add_to(gradient, corner[3], scaled(stiffness, by_corner[3]))
    return total


# --- sweeps ----------------------------------------------------------------------------------------------------------


@kernel
def sweep(x, problem, around, guarded):
    """One sweep of vertex block descent over ``x`` [m] (V, 3), in place; bending by hinges.

    ``guarded``: a vertex whose step does not lower the energy halves it, and stays after six halvings.
    """
    for v in problem.order:
        own = at(x, v)
        _, gradient, hessian = outside(own, v, problem, around)
        gradient, hessian = _membrane_block(x, v, problem, gradient, hessian)
        gradient, hessian = _hinge_block(x, v, problem, gradient, hessian)
        step = _limited_step(gradient, hessian, problem.constants)
        if guarded:
            before = _local_energy(x, own, v, problem, around)
            share = problem.constants.one
            for _ in range(TRIES):
                if _local_energy(x, add(own, scaled(share, step)), v, problem, around) <= before:
                    break
                share *= problem.constants.half
            else:
                share = problem.constants.zero
            step = scaled(share, step)
        x[v, 0], x[v, 1], x[v, 2] = own[0] + step[0], own[1] + step[1], own[2] + step[2]


@part
def _limited_step(gradient, hessian, k):
    step = scaled(-k.one, solved(shifted(hessian, k.least), gradient))
    length = np.sqrt(dot(step, step))
    if length > k.reach:
        step = scaled(k.reach / length, step)
    return step


@part
def _corner(x, own, triangles, entry):
    """The columns of F of the triangle at ``entry`` with its corner at ``own``, that corner's slopes, and the area."""
    slope = triangles.slope
    p1, t1, p2, t2 = slope[entry, 0], slope[entry, 1], slope[entry, 2], slope[entry, 3]
    first, second = sub(at(x, triangles.other[entry, 0]), own), sub(at(x, triangles.other[entry, 1]), own)
    along, across = columns(first, second, p1, p2, t1, t2)
    return along, across, -p1 - p2, -t1 - t2, slope[entry, 4]


@part
def _membrane_block(x, v, problem, gradient, hessian):
    """``gradient`` and ``hessian`` of vertex v plus those of its triangles: Gauss-Newton, and the stress that pulls."""
    k, t = problem.constants, problem.triangles
    own = at(x, v)
    for entry in range(t.start[v], t.start[v + 1]):
        along, across, mp, mt, area = _corner(x, own, t, entry)
        cp, ct = corner_force(along, across, mp, mt, area, k)
        gradient = add(gradient, mix(cp, along, ct, across))
        kpp, ktt, kpt = corner_stiffness(mp, mt, area, k)
        hessian = outer(outer(hessian, kpp - kpt, along), ktt - kpt, across)
        hessian = outer(hessian, kpt, add(along, across))
        pull = cp * mp + ct * mt
        if pull > k.zero:
            hessian = shifted(hessian, pull)
    return gradient, hessian


@part
def _hinge_block(x, v, problem, gradient, hessian):
    """The same plus those of its hinges: Gauss-Newton of the angle, as stiff folded as flat, so that it bounds the
    curvature."""
    k, hinges = problem.constants, problem.hinges
    for entry in range(hinges.start[v], hinges.start[v + 1]):
        stiffness, force, turn = hinge_corner(x, hinges, hinges.member[entry], k)
        gradient = add(gradient, scaled(stiffness, force))
        hessian = outer(hessian, stiffness, turn)
    return gradient, hessian


@part
def _local_energy(x, own, v, problem, around):
    """Energy [J] of all that vertex v moves, with v at ``own``."""
    k, t, hinges = problem.constants, problem.triangles, problem.hinges
    total, _, _ = outside(own, v, problem, around)
    for entry in range(t.start[v], t.start[v + 1]):
        along, across, _, _, area = _corner(x, own, t, entry)
        total += stress(along, across, area, k)[3]
    for entry in range(hinges.start[v], hinges.start[v + 1]):
        h, place = hinges.member[entry] // 4, hinges.member[entry] % 4
        corner = hinges.corner[h]
        first = own if place == 0 else at(x, corner[0])
        second = own if place == 1 else at(x, corner[1])
        third = own if place == 2 else at(x, corner[2])
        fourth = own if place == 3 else at(x, corner[3])
        turned, _, _ = fold((first, second, third, fourth), hinges.cosine[h], hinges.sine[h], k)
        total += hinges.stiffness[h] * turned
    return total


@kernel
def diagonal_blocks(x, problem, around, blocks):
    """Writes the positive Hessian blocks (V, 3, 3) with which ``sweep`` moves the vertices."""
    k = problem.constants
    for v in range(len(x)):
        own = at(x, v)
        _, gradient, hessian = outside(own, v, problem, around)
        gradient, hessian = _membrane_block(x, v, problem, gradient, hessian)
        _, h = _hinge_block(x, v, problem, gradient, hessian)
        h = shifted(h, k.least)
        blocks[v, 0, 0], blocks[v, 0, 1], blocks[v, 0, 2] = h[0], h[1], h[2]
        blocks[v, 1, 0], blocks[v, 1, 1], blocks[v, 1, 2] = h[1], h[3], h[4]
        blocks[v, 2, 0], blocks[v, 2, 1], blocks[v, 2, 2] = h[2], h[4], h[5]
