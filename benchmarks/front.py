"""The picture of the trade between time and gain, drawn from its record.

    python -m benchmarks.front

Writes ``docs/images/tradeoff.webp``: for every combination of knobs the time of a frame over the rival's and what is
left of the way to physics, on garments trained on and on others, and total curvature over that of physics; tiers by
name.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.harness import RESULTS_DIR, ROOT
from benchmarks.tables import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PICTURE = ROOT / "docs" / "images" / "tradeoff.webp"
TRAINED = ("tshirt", "dress", "trousers")
COLOURS = {"instant": "#8c8c8c", "fast": "#2a9d8f", "balanced": "#1d4e89", "accurate": "#9b2226"}


def points(rows: list[Row], figure: str, garments: Callable[[str], bool]) -> list[tuple[float, float, str]]:
    """Returns, for each combination of knobs in ``rows``, the means of ``time_ratio`` and of ``figure`` over those
    garments for whose name ``garments`` is true, and the tier that has these knobs, "" for none."""
    means = []
    for knobs in dict.fromkeys(row["knobs"] for row in rows if row["knobs"]):
        some = [row for row in rows if row["knobs"] == knobs and garments(row["garment"])]
        time, value = (float(np.mean([row[name] for row in some])) for name in ("time_ratio", figure))
        means.append((time, value, some[0]["tier"]))
    return means


def draw_front(pane: Axes, means: list[tuple[float, float, str]], title: str) -> None:
    """Draws what ``points`` returned into ``pane``: a dot each, large and with its name for a tier."""
    for time, value, tier in means:
        pane.plot(time, value, "o", ms=9 if tier else 4, color=COLOURS.get(tier, "#c9c9c9"), zorder=3 if tier else 2)
        if tier:
            place = {"xytext": (0, 9), "textcoords": "offset points", "ha": "center", "color": COLOURS[tier]}
            pane.annotate(tier, (time, value), **place)
    pane.set(xscale="log", xlim=(0.07, 0.8), title=title, xlabel="time of a frame, skinning with push-out = 1")
    pane.set_xticks([0.1, 0.2, 0.3, 0.5, 0.7], ["0.1", "0.2", "0.3", "0.5", "0.7"], minor=False)
    pane.minorticks_off()
    pane.grid(alpha=0.25)


def main() -> None:
    """Runs the command line: draws the record ``tradeoff.json`` as ``docs/images/tradeoff.webp``."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    record = json.loads((RESULTS_DIR / "tradeoff.json").read_text(encoding="utf-8"))
    named = {row["knobs"]: row["tier"] for row in record["means"]}
    rows = [
        row | {"tier": named.get(row["knobs"], "").split(", ")[-1], "left": 1.0 - row["gain"]} for row in record["rows"]
    ]
    figure, panes = pyplot.subplots(1, 3, figsize=(13.0, 3.8))
    draw_front(panes[0], points(rows, "left", TRAINED.__contains__), "garments trained on")
    draw_front(panes[1], points(rows, "left", lambda name: name not in TRAINED), "a stranger's T-shirt")
    draw_front(panes[2], points(rows, "curvature", lambda _: True), "all, how crumpled")
    for pane in panes[:2]:
        pane.set(yscale="log", ylim=(0.6, 0.004))
        pane.minorticks_off()
        pane.set_yticks([0.5, 0.2, 0.1, 0.05, 0.02, 0.01], ["0.50", "0.80", "0.90", "0.95", "0.98", "0.99"])
    panes[0].set_ylabel("gain, 1 = physics")
    panes[2].set(ylabel="curvature, 1 = physics", ylim=(2.3, 0.6))
    figure.tight_layout()
    figure.savefig(PICTURE, dpi=110)


if __name__ == "__main__":
    main()
