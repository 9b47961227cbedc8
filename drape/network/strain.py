"""Strain of posed charts and the force on their jets, compiled: ``training.consensus.strain_and_force``, softened.

At each of seven points the tangents t_u, t_v are those at rest plus what the jets add. With the products of unit
vectors m of ``PatchRows.unit``, strain is linear in the products g of the tangents:

    E11 = (aa g_uu - 1) / 2,   E22 = (bb g_uu + 2 bc g_uv + cc g_vv - 1) / 2,   2 E12 = ab g_uu + ac g_uv.
"""

from __future__ import annotations

import numpy as np

from drape.garment.consensus import STRAIN_POINTS, TRACE_SHARE, strain_points
from drape.geometry import jets
from drape.kernels.compiled import kernel, part
from drape.kernels.lanes import LANES, put, root, row_at

PLANE, HEIGHT, POINTS = jets.IN_PLANE_COUNT, jets.HEIGHT_COUNT, STRAIN_POINTS
_U = jets.basis_derivative(strain_points(), jets.HEIGHT_ORDER, u_times=1).astype(np.float32)  # (7, 15)
_V = jets.basis_derivative(strain_points(), jets.HEIGHT_ORDER, v_times=1).astype(np.float32)
SOFTENING = 4.0  # of training.consensus.softened: 4 x / (1 + |4 x|)


@part
def soft(a):
    """``a / (1 + |a|)``."""
    return a / (root(a * a) + 1.0)


@kernel
def feel_strain(jets_of, rows, force, felt_rows):
    """Writes softened strain (21 rows) and force (27 rows) of ``jets_of`` to ``felt_rows`` (both ``Rows``). ``force``
    is scratch of 27 rows."""
    jet, felt = jets_of.values, felt_rows.values
    for block in range(len(rows.scale) // LANES):
        own, at = LANES * jets_of.count * block, LANES * (felt_rows.count * block + felt_rows.first)
        still = LANES * 6 * POINTS * block
        for i in range(jets.JET_COUNT):
            put(force, LANES * i, row_at(jet, own) * 0.0)
        for point in range(POINTS):
            u = _tangent(jet, own, rows, still, _U[point], point)
            v = _tangent(jet, own, rows, still + LANES * 3 * POINTS, _V[point], point)
            uu = u[0] * u[0] + u[1] * u[1] + u[2] * u[2]
            uv = u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
            vv = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
            unit = LANES * (6 * POINTS * block + point)
            aa, ab = row_at(rows.unit, unit), row_at(rows.unit, unit + LANES * POINTS)
            ac, bb = row_at(rows.unit, unit + 2 * LANES * POINTS), row_at(rows.unit, unit + 3 * LANES * POINTS)
            bc, cc = row_at(rows.unit, unit + 4 * LANES * POINTS), row_at(rows.unit, unit + 5 * LANES * POINTS)
            half = 0.5 * SOFTENING
            e, f = half * (aa * uu) - half, half * (bb * uu + 2.0 * (bc * uv) + cc * vv) - half
            g = SOFTENING * (ab * uu + ac * uv)
            put(felt, at + LANES * point, soft(e))
            put(felt, at + LANES * (POINTS + point), soft(f))
            put(felt, at + LANES * (2 * POINTS + point), soft(g))
            by_e, by_f, by_g = (
                (1.0 + TRACE_SHARE) * e + TRACE_SHARE * f,
                TRACE_SHARE * e + (1.0 + TRACE_SHARE) * f,
                0.5 * g,
            )
            by_uu = aa * by_e + bb * by_f + 2.0 * (ab * by_g)  # twice the derivative by g_uu
            by_uv, by_vv = bc * by_f + ac * by_g, cc * by_f
            along_u = by_uu * u[0] + by_uv * v[0], by_uu * u[1] + by_uv * v[1], by_uu * u[2] + by_uv * v[2]
            along_v = by_vv * v[0] + by_uv * u[0], by_vv * v[1] + by_uv * u[1], by_vv * v[2] + by_uv * u[2]
            for i in range(PLANE):
                for axis in range(2):
                    place = LANES * (PLANE * axis + i)
                    put(
                        force, place, row_at(force, place) + along_u[axis] * _U[point, i] + along_v[axis] * _V[point, i]
                    )
            for i in range(HEIGHT):
                place = LANES * (2 * PLANE + i)
                put(force, place, row_at(force, place) + along_u[2] * _U[point, i] + along_v[2] * _V[point, i])
        for i in range(jets.JET_COUNT):
            put(felt, at + LANES * (3 * POINTS + i), soft(row_at(force, LANES * i)))


@part
def _tangent(jet, own, rows, still, terms, point):
    """A tangent: at rest, three rows of all points from ``still`` on, and what the jets from ``own`` on add to it."""
    x = row_at(rows.tangent, still + LANES * point)
    y = row_at(rows.tangent, still + LANES * (POINTS + point))
    z = row_at(rows.tangent, still + LANES * (2 * POINTS + point))
    for i in range(1, PLANE):  # the derivative of the constant is zero
        x = x + row_at(jet, own + LANES * i) * terms[i]
        y = y + row_at(jet, own + LANES * (PLANE + i)) * terms[i]
    for i in range(1, HEIGHT):
        z = z + row_at(jet, own + LANES * (2 * PLANE + i)) * terms[i]
    return x, y, z
