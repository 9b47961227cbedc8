"""Constants of folds as a graphics card reads them: with the order in which its threads may work at once."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from drape.engine.library import LANES
from drape.live.eased import Levels
from drape.live.fold_constants import FoldConstants
from drape.live.whole import PanelLevels, StiffnessFactor

Cloth = TypeVar("Cloth", FoldConstants, Levels)


def for_card(cloth: Cloth) -> Cloth:
    """Returns a copy of the constants of folds ``cloth`` for a card: its stiffness factor has ``PanelLevels``, which a
    processor does without."""
    if isinstance(cloth, Levels):
        return replace(cloth, coarse=for_card(cloth.coarse))
    return replace(cloth, factor=cloth.factor._replace(levels=panel_levels(cloth.factor)))


def panel_levels(factor: StiffnessFactor) -> PanelLevels:
    """Returns the order in which a card multiplies the panels of ``factor``."""
    panels, count = len(factor.size), len(factor.place)
    panel = np.repeat(np.arange(panels), np.diff(factor.column))
    entry = np.concatenate([np.arange(size) + start for size, start in zip(factor.size, factor.start, strict=False)])
    member, of = factor.member[entry], np.repeat(np.arange(panels), factor.size)
    level = np.zeros(panels, np.int64)
    for own, above in np.unique(np.stack([of, panel[member]]), axis=1).T:  # panels ascend
        if above > own:
            level[above] = max(level[above], level[own] + 1)
    later = panel[member] > of
    order = np.argsort(member[later], kind="stable")
    to = np.full(len(factor.member), -1)
    to[entry[later][order]] = np.arange(len(order))
    to[entry[~later]] = len(order) + member[~later]
    rows = np.diff(factor.start) // LANES
    row_panel = np.repeat(np.arange(panels), rows)
    row = LANES * (np.arange(rows.sum()) - np.repeat(np.cumsum(rows) - rows, rows))
    blocks, columns = (np.argsort(level[owner], kind="stable") for owner in (row_panel, panel))
    starts = [np.searchsorted(np.sort(level[owner]), np.arange(level.max() + 2)) for owner in (row_panel, panel)]
    left = np.append(0, np.cumsum(np.bincount(member[later], minlength=count)))
    tables = starts[0], row_panel[blocks], row[blocks], starts[1], columns, panel, left, to
    return PanelLevels(*(table.astype(np.int32) for table in tables))
