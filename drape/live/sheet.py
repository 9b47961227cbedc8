"""A cloth as the engine reads it for folds: in blocks of ``LANES`` vertices of one colour.

No two vertices of a colour share an element, so that a block's vertices may move at once. Every table has the numbers
of a block's vertices next to each other, as vector instructions take them. A block that its colour does not fill ends
with empty places, which nothing pulls. All tables are in the order of places, block after block.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.cloth.problem import KernelConstants, Problem, Triangles, problem
from drape.engine.library import LANES

ALIKE = 0.99  # edges as long as this share of the longest one count as equally long


class Creases(NamedTuple):
    """The H hinges that are not flat at rest: the places ``corner`` (H, 4), ``stiffness`` [J] (H,), and ``cosine``,
    ``sine`` (H,) of the rest angle."""

    corner: np.ndarray
    stiffness: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray


class Sheet(NamedTuple):
    """A cloth of V vertices in B blocks of ``LANES`` places, one vertex a place. There are P = B ``LANES`` places, some
    empty. Tables are flat, row after row of a block, ``LANES`` numbers each.

    ``vertex`` (P,): the garment's vertex at each place, 0 at empty ones; ``place`` (V,): the place of each vertex.

    Triangles: block b has the entries ``fan_start[b]`` to ``fan_start[b + 1]``. Each is one triangle of every vertex:
    two rows of ``fan_other``, the places of the other corners, and five of ``fan_slope``, their slopes [1/m] along warp
    and weft and the area [m^2]. Bending of hinges flat at rest: ``bend_start`` (B + 1,) counts rows of ``bend_other``,
    places, and of ``bend_value``, their numbers in the matrix Q [N/m]. ``own`` has four rows a block: weight [N], the
    diagonal of Q, contact's stiffness and that of the spring to where the network has the vertex [N/m].

    Block b has the entries ``crease_start[b]`` to ``crease_start[b + 1]`` of ``crease_lane``, a lane of the block, and
    of ``crease_member``, 4 h + c where that lane is corner c of hinge h of the ``creases``. The blocks of a colour
    begin at ``colour_start`` (C + 1,).
    """

    constants: KernelConstants
    vertex: np.ndarray
    place: np.ndarray
    fan_start: np.ndarray
    fan_other: np.ndarray
    fan_slope: np.ndarray
    bend_start: np.ndarray
    bend_other: np.ndarray
    bend_value: np.ndarray
    own: np.ndarray
    creases: Creases
    crease_start: np.ndarray
    crease_lane: np.ndarray
    crease_member: np.ndarray
    colour_start: np.ndarray


def sheet(
    cloth: ClothMesh, material: Material, band_n_per_m: np.ndarray, *, dtype: type[np.floating] = np.float32
) -> Sheet:
    """Returns the tables of ``cloth`` made of ``material``, floats of ``dtype``. ``band_n_per_m`` [N/m] (V,) is the
    stiffness of the springs that hold vertices where the network has them."""
    flat = problem(cloth, material, dtype=dtype)
    blocks = _blocks(flat)
    real = blocks >= 0
    vertex = np.where(real, blocks, 0).astype(np.int32)
    place = np.empty(cloth.vertex_count, np.int32)
    place[blocks[real]] = np.flatnonzero(real.reshape(-1))
    fan_start, fan_row, fan_real = _rows(flat.triangles.start, blocks)
    fan_row = longest_first(flat.triangles)[fan_row]
    other = np.where(
        fan_real[:, None], place[flat.triangles.other[fan_row]].transpose(0, 2, 1), _own_places(fan_start)[:, None]
    )
    slope = np.where(fan_real[:, None], flat.triangles.slope[fan_row].transpose(0, 2, 1), 0.0)
    bend = flat.quadratic
    bend_start, bend_row, bend_real = _rows(bend.start, blocks)
    bend_other = np.where(bend_real, place[_values_at(bend.vertex, bend_row)], _own_places(bend_start))
    bend_value = np.where(bend_real, _values_at(bend.value, bend_row), 0.0)
    own = np.stack([flat.weight_n, bend.diagonal, flat.contact_n_per_m, band_n_per_m])
    own = np.where(real[:, None], own[:, vertex].transpose(1, 0, 2), 0.0)
    creases = flat.creases
    crease_start, crease_lane, crease_member = _entries(creases.start, creases.member, blocks)
    return Sheet(
        constants=flat.constants,
        vertex=vertex.reshape(-1),
        place=place,
        fan_start=fan_start,
        fan_other=np.ascontiguousarray(other, np.int32).reshape(-1),
        fan_slope=np.ascontiguousarray(slope, dtype).reshape(-1),
        bend_start=bend_start,
        bend_other=np.ascontiguousarray(bend_other, np.int32).reshape(-1),
        bend_value=np.ascontiguousarray(bend_value, dtype).reshape(-1),
        own=np.ascontiguousarray(own, dtype).reshape(-1),
        creases=Creases(place[creases.corner], creases.stiffness, creases.cosine, creases.sine),
        crease_start=crease_start,
        crease_lane=crease_lane,
        crease_member=crease_member,
        colour_start=np.append(0, np.cumsum(-(-np.diff(flat.colour_start) // LANES))).astype(np.int32),
    )


def longest_first(triangles: Triangles) -> np.ndarray:
    """Returns an order (3F,) of the rows of ``triangles`` in which the first row of each vertex has its longest edge at
    rest to a second corner.

    That edge says how the vertex's frame is turned, and a short one turns with every ripple. Among edges that are
    ``ALIKE`` it is the first one, whatever rounding does.
    """
    p1, t1, p2, t2, _ = np.asarray(triangles.slope, np.float64).T
    length = np.hypot(p2, t2) / np.abs(p1 * t2 - p2 * t1)
    vertex = np.repeat(np.arange(len(triangles.start) - 1), np.diff(triangles.start))
    order = np.arange(len(vertex))
    most = np.zeros(len(triangles.start) - 1)
    np.maximum.at(most, vertex, length)
    short = length < ALIKE * most[vertex]
    longest = np.lexsort((short, vertex))[triangles.start[:-1][np.diff(triangles.start) > 0]]
    first = triangles.start[vertex[longest]]
    order[first], order[longest] = longest, first
    return order


def _blocks(flat: Problem) -> np.ndarray:
    """Vertices (B, ``LANES``) of each block, -1 at empty places; those of a colour by the number of their triangles."""
    valence = np.diff(flat.triangles.start)
    blocks = []
    for start, end in zip(flat.colour_start[:-1], flat.colour_start[1:], strict=True):
        members = flat.order[start:end]
        members = members[np.argsort(valence[members], kind="stable")]
        blocks.append(np.concatenate([members, np.full(-len(members) % LANES, -1)]).reshape(-1, LANES))
    return np.concatenate(blocks)


def _rows(start: np.ndarray, blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A table whose entries of vertex v begin at ``start[v]``, as rows of blocks.

    Returns where each block's rows begin (B + 1,), the entry (n, ``LANES``) in each lane, and whether there is one.
    """
    count = np.where(blocks >= 0, np.diff(start)[blocks], 0)
    rows = count.max(axis=1)
    first = np.concatenate([[0], np.cumsum(rows)])
    block = np.repeat(np.arange(len(blocks)), rows)
    number = np.arange(first[-1]) - first[block]
    real = number[:, None] < count[block]
    return first.astype(np.int32), np.where(real, start[blocks[block]] + number[:, None], 0), real


def _own_places(start: np.ndarray) -> np.ndarray:
    """The place (n, ``LANES``) that each row of a table belongs to."""
    block = np.repeat(np.arange(len(start) - 1), np.diff(start))
    return LANES * block[:, None] + np.arange(LANES)


def _values_at(values: np.ndarray, index: np.ndarray) -> np.ndarray:
    """``values[index]``, zeros where there are no values."""
    return values[index] if len(values) else np.zeros(index.shape, values.dtype)


def _entries(start: np.ndarray, member: np.ndarray, blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where each block's entries of ``member`` begin (B + 1,), their lanes and themselves."""
    first, row, real = _rows(start, blocks)
    _, lane = np.nonzero(real)
    held = np.add.reduceat(np.append(real.sum(axis=1), 0), first)[:-1] * (np.diff(first) > 0)
    begins = np.concatenate([[0], np.cumsum(held)])
    return begins.astype(np.int32), lane.astype(np.int32), _values_at(member, row)[real].astype(np.int32)
