"""Vertices in the order of their mesh and at the places where kernels have them (``Sheet``): from one to the other."""

from __future__ import annotations

import numpy as np

from drape.contact.projection import MOVED_M
from drape.kernels.compiled import kernel
from drape.kernels.elements import at, dot, sub
from drape.kernels.lanes import LANES, most, number_at, points_at, points_in, put, put_points, row_at


@kernel
def placed(vertices, vertex):
    """The ``vertices`` [m] (V, 3) at their places (P, 3); ``vertex`` (P,) is the one at each."""
    places, whole = np.empty((len(vertex), 3), vertices.dtype), len(vertex) // LANES * LANES
    for p in range(0, whole, LANES):
        put_points(places, p, points_at(vertices, vertex, p))
    for p in range(whole, len(vertex)):
        for axis in range(3):
            places[p, axis] = vertices[vertex[p], axis]
    return places


@kernel
def delivered(x, lifted, place, vertices):
    """The ``vertices`` [m] (V, 3) are written from what is at the ``place`` (V,) of each; and the share of them that
    were ``lifted`` [m] (P,) by more than ``MOVED_M``, and the most of any."""
    count, farthest, whole = 0, lifted.dtype.type(0), len(place) // LANES * LANES
    for v in range(0, whole, LANES):
        put_points(vertices, v, points_at(x, place, v))
    for v in range(whole, len(place)):
        for axis in range(3):
            vertices[v, axis] = x[place[v], axis]
    for v in range(len(place)):
        own = number_at(lifted, place[v])
        count += own > MOVED_M
        farthest = max(farthest, own)
    return count / len(place), float(farthest)


@kernel
def farthest_place_m(x, y):
    """The largest distance [m] between a place of ``x`` (P, 3) and that of ``y``, NaN where one is."""
    numbers = np.zeros(2 * LANES, x.dtype)
    worst, total = row_at(numbers, 0), row_at(numbers, LANES)
    for block in range(len(x) // LANES):
        way = sub(points_in(x, LANES * block), points_in(y, LANES * block))
        worst, total = most(dot(way, way), worst), total + dot(way, way)
    put(numbers, 0, worst)
    put(numbers, LANES, total)
    square, odd = numbers[0], False
    for lane in range(LANES):
        square, odd = max(square, numbers[lane]), odd or numbers[LANES + lane] != numbers[LANES + lane]
    return np.sqrt(square) if not odd else x.dtype.type(np.nan)


@kernel
def moved_m(before, network, place):
    """RMS way [m] of the vertices at the ``place`` (V,) of each, from ``before`` to ``network`` [m] (P, 3)."""
    total = 0.0
    for v in range(len(place)):
        way = sub(at(network, place[v]), at(before, place[v]))
        total += dot(way, way)
    return np.sqrt(total / len(place))
