"""Constants of folds as a graphics card reads them: with the order in which its threads may work at once."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from drape.live.eased import Levels
from drape.live.fold_constants import FoldConstants
from drape.live.whole import panel_levels

Cloth = TypeVar("Cloth", FoldConstants, Levels)


def for_card(cloth: Cloth) -> Cloth:
    """The same ``cloth`` with the levels of its factor's panels."""
    if isinstance(cloth, Levels):
        return replace(cloth, coarse=for_card(cloth.coarse))
    return replace(cloth, factor=cloth.factor._replace(levels=panel_levels(cloth.factor)))
