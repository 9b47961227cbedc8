"""Constants of folds as a graphics card reads them: with a solve whose steps are few and done by all threads at once.

K = L D L^T has an elimination tree of forty levels, and a card waits at each. So parts of the tree are taken together,
from its leaves on: a domain has columns J and touches rows R of later ones,

    S = (L_JJ D_J L_JJ^T)^-1,   W = -(L_RJ L_JJ^-1)^T,   y_R += W^T y_J  on the way down,   x_J = S y_J + W x_R  up.

Domains of one stage do not touch. What is left has no R, a dense inverse: three to seven products in place of eighty.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
import scipy.linalg
import scipy.sparse

from drape.engine.library import LANES
from drape.live.eased import Levels
from drape.live.fold_constants import FoldConstants
from drape.live.whole import SolveStages, StiffnessFactor

Cloth = TypeVar("Cloth", FoldConstants, Levels)

# Columns of a domain: each stage has so many times those of the one before, below a share of all. Fewer stages read
# more numbers, and a card waits a microsecond at the end of each.
SMALLEST, TIMES, SHARE = 32, 5, 1 / 8


class Domain(NamedTuple):
    """Columns (J,) that are eliminated together, rows (R,) that they touch, ``inverse`` (J, J) and ``way`` (J, R)."""

    own: np.ndarray
    below: np.ndarray
    inverse: np.ndarray
    way: np.ndarray


class Block(NamedTuple):
    """``LANES`` rows ``to`` of a product, its columns ``taken`` (K,), and their numbers (K, LANES)."""

    to: np.ndarray
    taken: np.ndarray
    value: np.ndarray


def for_card(cloth: Cloth) -> Cloth:
    """The same ``cloth`` with the stages of its solve."""
    if isinstance(cloth, Levels):
        return replace(cloth, coarse=for_card(cloth.coarse))
    return replace(cloth, factor=cloth.factor._replace(stages=solve_stages(cloth.factor)))


def solve_stages(factor: StiffnessFactor) -> SolveStages:
    """The stages of the solve of ``factor``, in numbers of its type."""
    count, stages = len(factor.place), _domains(factor)
    steps = [list(_down(stages[:number], domains)) for number, domains in enumerate(stages) if number]
    steps += [[block for one in domains for block in _up(one, count)] for domains in reversed(stages)]
    blocks = [block for step in steps for block in step]
    return SolveStages(
        block=np.cumsum([0, *map(len, steps)], dtype=np.int32),
        to=np.concatenate([block.to for block in blocks]).astype(np.int32),
        entry=np.cumsum([0, *(len(block.taken) for block in blocks)], dtype=np.int32),
        taken=np.concatenate([block.taken for block in blocks]).astype(np.int32),
        value=np.concatenate([block.value.reshape(-1) for block in blocks]).astype(factor.value.dtype),
    )


def _domains(factor: StiffnessFactor) -> list[list[Domain]]:
    """The domains of each stage."""
    lower, stage, top = _lower(factor), _stages(factor), len(factor.size)
    panel = np.repeat(np.arange(top), np.diff(factor.column))
    found = []
    for number in range(stage[:, 0].max() + 1):
        groups = np.unique(stage[stage[:, 0] == number, 1])
        found.append([_domain(lower, np.flatnonzero(stage[panel, 1] == group), factor.inverse) for group in groups])
    return found


def _stages(factor: StiffnessFactor) -> np.ndarray:
    """The stage and the domain of each panel (N, 2): whole branches of the tree that have few enough columns."""
    width, count = np.diff(factor.column), len(factor.size)
    owner = np.repeat(np.arange(count), width)
    parent = np.full(count, -1)
    for panel, (start, size) in enumerate(zip(factor.start, factor.size, strict=False)):
        member = factor.member[start : start + size]
        above = member[member >= factor.column[panel + 1]]
        parent[panel] = owner[above.min()] if len(above) else -1
    found, most, number = np.full((count, 2), -1), SMALLEST, 0
    while most < SHARE * width.sum():
        total = np.where(found[:, 0] < 0, width, 0)
        for panel in np.flatnonzero(parent >= 0):  # children come before their parents
            total[parent[panel]] += total[panel]
        for panel in np.flatnonzero((found[:, 0] < 0) & (total <= most))[::-1]:
            above = parent[panel]
            joins = above >= 0 and found[above, 0] == number
            found[panel] = number, found[above, 1] if joins else panel
        most, number = TIMES * most, number + 1
    found[found[:, 0] < 0] = number, count
    return found


def _lower(factor: StiffnessFactor) -> Any:
    """L (V, V) of the ``factor``, sparse, by columns."""
    rows, columns, values = [], [], []
    for panel, (begin, end) in enumerate(zip(factor.column[:-1], factor.column[1:], strict=True)):
        size, start, entry = (int(array[panel]) for array in (factor.size, factor.start, factor.entry))
        stride, width = int(factor.start[panel + 1]) - start, int(end - begin)
        dense = factor.value[entry : entry + width * stride].reshape(width, stride)[:, :size].T.astype(np.float64)
        own = np.linalg.inv(dense[:width] + np.eye(width))
        rows.append(np.tile(factor.member[start : start + size], width))
        columns.append(np.repeat(np.arange(begin, end), size))
        values.append(np.concatenate([own, -dense[width:] @ own]).T.reshape(-1))
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    found = scipy.sparse.csc_matrix(entries, shape=(len(factor.place),) * 2)
    found.eliminate_zeros()
    return found


def _domain(lower: Any, own: np.ndarray, inverse: np.ndarray) -> Domain:
    columns = lower[:, own]
    below = np.setdiff1d(columns.indices, own)
    root = scipy.linalg.solve_triangular(columns[own].toarray(), np.eye(len(own)), lower=True)
    return Domain(own, below, root.T * inverse[own] @ root, -(columns[below].toarray() @ root).T)


def _down(before: Sequence[Sequence[Domain]], domains: Sequence[Domain]) -> Iterator[Block]:
    """What domains of stages ``before`` leave for the rows of ``domains``, those that the same ones touch together."""
    givers = [one for stage in before for one in stage]
    touched: dict[int, list[int]] = {int(row): [] for one in domains for row in one.own}
    for number, giver in enumerate(givers):
        for row in giver.below.tolist():
            if row in touched:
                touched[row].append(number)
    order = sorted((row for row in touched if touched[row]), key=lambda row: (touched[row], row))
    for first in range(0, len(order), LANES):
        to = np.array(order[first : first + LANES])
        numbers = sorted({number for row in to.tolist() for number in touched[row]})
        values = []
        for giver in (givers[number] for number in numbers):
            place = np.minimum(np.searchsorted(giver.below, to), len(giver.below) - 1)
            values.append(giver.way[:, place] * (giver.below[place] == to))
        yield _block(to, np.concatenate([givers[number].own for number in numbers]), np.concatenate(values))


def _up(one: Domain, count: int) -> Iterator[Block]:
    """The result in the rows of a domain, which begin with ``count``."""
    values = np.concatenate([one.inverse, one.way.T])
    for first in range(0, len(one.own), LANES):
        rows = slice(first, first + LANES)
        yield _block(one.own[rows] + count, np.append(one.own, one.below + count), values[:, rows])


def _block(to: np.ndarray, taken: np.ndarray, value: np.ndarray) -> Block:
    missing = LANES - len(to)
    return Block(np.pad(to, (0, missing), constant_values=-1), taken, np.pad(value, ((0, 0), (0, missing))))
