"""Body proximity of posed patches, compiled: ``drape.contact.proximity`` in the patches' own frames.

Tangent planes of the body are looked up once, in the world; each pass moves points along the axes of their patch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.contact.field import BANDWIDTH_M, TINY
from drape.contact.projection import AGREEMENT, BESIDE_M2, OTHER_LEAST, REGION_BIAS_M2
from drape.contact.proximity import DEEP_M, GAP_M, OTHER_STEPS, UNIT_M
from drape.contact.push_tables import OWN_CLUSTERS
from drape.contact.samples import CLUSTER_SIZE, REGION_SIZE
from drape.garment.consensus import STRAIN_POINTS, strain_points
from drape.geometry import jets
from drape.kernels.compiled import kernel, part
from drape.kernels.lanes import (
    LANES,
    exponential,
    least,
    most,
    normals_at,
    put,
    put3,
    root,
    row_at,
    rows3_at,
    samples_at,
    tangent,
    where_above,
)
from drape.network.frames import FRAME, SCALE, centres_of, into_frame, out_of_frame
from drape.network.strain import HEIGHT, PLANE, POINTS, soft

_BASIS = jets.basis(strain_points(), jets.HEIGHT_ORDER).astype(np.float32)  # (7, 15)
_LOGS = np.log(np.arange(16) / OTHER_STEPS + OTHER_LEAST).astype(np.float32)
OWN, OTHER = OWN_CLUSTERS * CLUSTER_SIZE, 2 * REGION_SIZE  # samples of the own part, and of two regions of others
_ENTRIES = 8  # of a sample
PLANES = 6 * 2 * STRAIN_POINTS  # rows of a block's planes: normal, offset, share and pull of 7 points before two parts
_SCALE = 1.0 / (BANDWIDTH_M * BANDWIDTH_M)


class Seen(NamedTuple):
    """Scratch of a block: its points in their frames and in the world, the samples near it, their biases, whether any
    of them counts, and a row for each sample."""

    local: np.ndarray
    places: np.ndarray
    table: np.ndarray
    bias: np.ndarray
    there: np.ndarray
    scratch: np.ndarray


@kernel
def points_of(jet, at, rows, block, point):
    """A strain point of the patches of a block [patch scales]; their jets begin at ``at``."""
    place = LANES * (3 * POINTS * block + point)
    x, y = row_at(rows.place, place), row_at(rows.place, place + LANES * POINTS)
    z = row_at(rows.place, place + 2 * LANES * POINTS)
    for i in range(PLANE):
        x = x + row_at(jet, at + LANES * i) * _BASIS[point, i]
        y = y + row_at(jet, at + LANES * (PLANE + i)) * _BASIS[point, i]
    for i in range(HEIGHT):
        z = z + row_at(jet, at + LANES * (2 * PLANE + i)) * _BASIS[point, i]
    return x, y, z


@kernel
def find_planes(jets_of, body, frames, rows, planes):
    """Writes the tangent ``planes`` (84 rows a block) of ``body`` near the patches of ``jets_of`` (``Rows``)."""
    jet, count = jets_of.values, jets_of.count
    kind = jet.dtype.type
    seen = Seen(
        np.empty(3 * LANES * POINTS, jet.dtype),
        np.empty(3 * LANES * POINTS, jet.dtype),
        np.empty(LANES * _ENTRIES * OWN, jet.dtype),
        np.empty(LANES * OWN, jet.dtype),
        np.empty(LANES, jet.dtype),
        np.empty(LANES * OWN, jet.dtype),
    )
    index, best = np.empty(LANES * OTHER, np.int32), np.empty(2 * LANES, jet.dtype)
    for block in range(len(rows.scale) // LANES):
        scale, centre = row_at(frames, LANES * (FRAME * block + SCALE)), centres_of(frames, block)
        middle = scale * 0.0, scale * 0.0, scale * 0.0
        for point in range(POINTS):
            x, y, z = points_of(jet, LANES * count * block, rows, block, point)
            put3(seen.local, 3 * LANES * point, (x, y, z))
            a, b, c = out_of_frame(frames, block, (scale * x, scale * y, scale * z))
            a, b, c = a + centre[0], b + centre[1], c + centre[2]
            put3(seen.places, 3 * LANES * point, (a, b, c))
            middle = middle[0] + a, middle[1] + b, middle[2] + c
        _take(body.skin, rows.sample, LANES * OWN * block, OWN, seen.table)
        for s in range(OWN):
            put(seen.bias, LANES * s, row_at(rows.bias, LANES * (OWN * block + s)))
        put(seen.there, 0, 1.0)
        _write(seen, OWN, frames, block, planes, PLANES * block)
        _nearest_regions(middle, body.region, rows.region, block, best)
        regions = len(body.region)
        for lane in range(LANES):
            share = kind(0)
            for s in range(OTHER):
                region = int(best[LANES * (s // REGION_SIZE) + lane])
                sample = REGION_SIZE * region + s % REGION_SIZE
                index[LANES * s + lane] = sample
                other = rows.other[LANES * (REGION_SIZE * regions * block + sample) + lane]
                seen.bias[LANES * s + lane] = _LOGS[other]
                share = max(share, kind(other >= 1))
            seen.there[lane] = share
        _take(body.skin, index, 0, OTHER, seen.table)
        _write(seen, OTHER, frames, block, planes, PLANES * block + 6 * POINTS)


@kernel
def _take(skin, index, start, count, table):
    """Writes ``count`` rows of samples of ``skin`` (S, 8) to ``table``, their eight numbers one after the other."""
    for s in range(count):
        x, y, z, square = samples_at(skin, index, start + LANES * s)
        a, b, c, across = normals_at(skin, index, start + LANES * s)
        at = LANES * _ENTRIES * s
        put(table, at, x)
        put(table, at + LANES, y)
        put(table, at + 2 * LANES, z)
        put(table, at + 3 * LANES, square)
        put(table, at + 4 * LANES, a)
        put(table, at + 5 * LANES, b)
        put(table, at + 6 * LANES, c)
        put(table, at + 7 * LANES, across)


@kernel
def _nearest_regions(middle, region, bias, block, best):
    """Writes the numbers of the two regions that are nearest to the ``middle`` (seven times it), by their bias."""
    x, y, z = middle[0] * (1.0 / POINTS), middle[1] * (1.0 / POINTS), middle[2] * (1.0 / POINTS)
    first, second = x * 0.0 - 1e30, x * 0.0 - 1e30
    one, other = x * 0.0, x * 0.0
    for r in range(len(region)):
        near = x * region[r, 0] + y * region[r, 1] + z * region[r, 2] - region[r, 3]
        score = row_at(bias, LANES * (len(region) * block + r)) * REGION_BIAS_M2 + 2.0 * near
        other = where_above(score, first, one, where_above(score, second, float(r), other))
        second = where_above(score, first, first, most(score, second))
        one = where_above(score, first, float(r), one)
        first = most(score, first)
    put(best, 0, one)
    put(best, LANES, other)


@part
def _ramp(value, low, high):
    return least(most((value - low) * (1.0 / (high - low)), 0.0), 1.0)


@kernel
def _write(seen, count, frames, block, planes, row):
    """Writes the planes of a block, from ``row`` on, of the means of ``count`` samples about each point."""
    table, bias, scratch = seen.table, seen.bias, seen.scratch
    scale = row_at(frames, LANES * (FRAME * block + SCALE))
    unit_per, faced = scale * (-1.0 / UNIT_M), row_at(seen.there, 0)
    for point in range(POINTS):
        x, y, z = rows3_at(seen.places, 3 * LANES * point)
        highest = x * 0.0 - 1e30
        for s in range(count):
            at = LANES * _ENTRIES * s
            near = x * row_at(table, at) + y * row_at(table, at + LANES) + z * row_at(table, at + 2 * LANES)
            logit = _SCALE * (2.0 * near - row_at(table, at + 3 * LANES)) + row_at(bias, LANES * s)
            put(scratch, LANES * s, logit)
            highest = most(logit, highest)
        total, a, b, c = x * 0.0, x * 0.0, x * 0.0, x * 0.0
        n, o, p, across = a, a, a, a
        for s in range(count):
            at, share = LANES * _ENTRIES * s, exponential(row_at(scratch, LANES * s) - highest)
            total = total + share
            a, b = a + share * row_at(table, at), b + share * row_at(table, at + LANES)
            c = c + share * row_at(table, at + 2 * LANES)
            n, o = n + share * row_at(table, at + 4 * LANES), o + share * row_at(table, at + 5 * LANES)
            p, across = p + share * row_at(table, at + 6 * LANES), across + share * row_at(table, at + 7 * LANES)
        per = 1.0 / total
        fading = faced * per
        n, o, p, across = fading * n, fading * o, fading * p, fading * across
        length = root(most(n * n + o * o + p * p, TINY))
        unit = n / length, o / length, p / length
        i, j, k = x - per * a, y - per * b, z - per * c
        along = unit[0] * i + unit[1] * j + unit[2] * k
        distance = 0.5 * (n * x + o * y + p * z - across + along)
        beside = i * i + j * j + k * k - along * along
        share = _ramp(beside, BESIDE_M2[0], BESIDE_M2[1]) * _ramp(distance, DEEP_M[0], DEEP_M[1])
        share = share * _ramp(length, AGREEMENT[0], AGREEMENT[1])
        n, o, p = into_frame(frames, block, (unit_per * unit[0], unit_per * unit[1], unit_per * unit[2]))
        i, j, k = rows3_at(seen.local, 3 * LANES * point)
        at = LANES * (row + 6 * point)
        put(planes, at, n)
        put(planes, at + LANES, o)
        put(planes, at + 2 * LANES, p)
        put(planes, at + 3 * LANES, (GAP_M - distance) * (1.0 / UNIT_M) - (n * i + o * j + p * k))
        put(planes, at + 4 * LANES, share)
        put(planes, at + 5 * LANES, share / unit_per)


@kernel
def feel_body(jets_of, rows, planes, force, felt_rows):
    """Writes closeness (14 rows) to the ``planes`` and their softened force (27 rows) on ``jets_of`` to ``felt_rows``
    (both ``Rows``). ``force`` is scratch of 27 rows."""
    jet, felt = jets_of.values, felt_rows.values
    for block in range(len(rows.scale) // LANES):
        own, at = LANES * jets_of.count * block, LANES * (felt_rows.count * block + felt_rows.first)
        for i in range(jets.JET_COUNT):
            put(force, LANES * i, row_at(jet, own) * 0.0)
        for point in range(POINTS):
            x, y, z = points_of(jet, own, rows, block, point)
            push = x * 0.0, x * 0.0, x * 0.0
            for side in range(2):
                near = LANES * (PLANES * block + 6 * (POINTS * side + point))
                n, o, p = row_at(planes, near), row_at(planes, near + LANES), row_at(planes, near + 2 * LANES)
                missing = row_at(planes, near + 3 * LANES) + n * x + o * y + p * z
                put(felt, at + LANES * (POINTS * side + point), row_at(planes, near + 4 * LANES) * tangent(missing))
                pull = row_at(planes, near + 5 * LANES) * most(missing, 0.0)
                push = push[0] + pull * n, push[1] + pull * o, push[2] + pull * p
            for i in range(PLANE):
                for axis in range(2):
                    place = LANES * (PLANE * axis + i)
                    put(force, place, row_at(force, place) + push[axis] * _BASIS[point, i])
            for i in range(HEIGHT):
                place = LANES * (2 * PLANE + i)
                put(force, place, row_at(force, place) + push[2] * _BASIS[point, i])
        for i in range(jets.JET_COUNT):
            put(felt, at + LANES * (2 * POINTS + i), soft(row_at(force, LANES * i)))
