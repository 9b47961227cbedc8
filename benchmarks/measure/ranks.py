"""Whether the network orders fabrics as physics does: Spearman's rank correlation over the fabrics of a garment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import spearmanr

RANKED = ("edge_pct", "hang_mm", "detail_mm")
FEWEST = 3  # two fabrics have an order by chance


def rank_correlations(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A line per garment of ``rows`` and method of ours: its correlation with physics in each of ``RANKED``.

    Over the ``fabrics`` that the garment was measured in; no line for fewer than three. 1 is the order of physics, -1
    the opposite; ties have the mean of their ranks. NaN where one of the two is the same in all fabrics.
    """
    found = []
    for garment in dict.fromkeys(row["garment"] for row in rows if "fabric" in row):
        own = {(row["method"], row["fabric"]): row for row in rows if row["garment"] == garment and "fabric" in row}
        fabrics = list(dict.fromkeys(name for _, name in own))
        if len(fabrics) < FEWEST:
            continue
        for method in ("network", "network_push", "folds"):
            if (method, fabrics[0]) not in own:
                continue
            line: dict[str, Any] = {"garment": garment, "method": method, "fabrics": len(fabrics)}
            for key in RANKED:
                of_network, of_physics = ([own[one, name][key] for name in fabrics] for one in (method, "physics"))
                line[key] = _spearman(of_network, of_physics)
            found.append(line)
    return found


def _spearman(first: list[float], second: list[float]) -> float:
    if min(np.ptp(first), np.ptp(second)) == 0.0:
        return float("nan")
    return float(spearmanr(first, second).statistic)  # pyright: ignore[reportAttributeAccessIssue]
