"""The picture of the trade between time and gain, drawn from its record.

    python -m benchmarks.front

Writes ``docs/images/tradeoff.webp``: for every combination of knobs the time of a frame over the rival's and what is
left of the way to physics, on garments trained on and on others; tiers by name.
"""

from __future__ import annotations

import json

import numpy as np

from benchmarks.harness import RESULTS_DIR, ROOT
from benchmarks.tables import Row

PICTURE = ROOT / "docs" / "images" / "tradeoff.webp"
TRAINED = ("tshirt", "dress", "trousers")
COLOURS = {"instant": "#8c8c8c", "fast": "#2a9d8f", "balanced": "#1d4e89", "accurate": "#9b2226"}


def points(rows: list[Row], *, trained: bool) -> list[tuple[float, float, str]]:
    """Time, 1 - gain and tier ("" for none) of each combination of knobs, means over the garments trained on or not."""
    found = []
    for knobs in dict.fromkeys(row["knobs"] for row in rows if row["knobs"]):
        some = [row for row in rows if row["knobs"] == knobs and (row["garment"] in TRAINED) == trained]
        time, gain = (float(np.mean([row[name] for row in some])) for name in ("time_ratio", "gain"))
        found.append((time, 1.0 - gain, some[0]["tier"]))
    return found


def main() -> None:
    """Command line entry."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    record = json.loads((RESULTS_DIR / "tradeoff.json").read_text(encoding="utf-8"))
    named = {row["knobs"]: row["tier"] for row in record["means"]}
    rows = [row | {"tier": named.get(row["knobs"], "").split(", ")[-1]} for row in record["rows"]]
    figure, panes = pyplot.subplots(1, 2, figsize=(9.0, 3.8), sharey=True)
    for pane, trained in zip(panes, (True, False), strict=True):
        for time, left, tier in points(rows, trained=trained):
            pane.plot(time, left, "o", ms=9 if tier else 4, color=COLOURS.get(tier, "#c9c9c9"), zorder=3 if tier else 2)
            if tier:
                pane.annotate(
                    tier, (time, left), xytext=(0, 9), textcoords="offset points", ha="center", color=COLOURS[tier]
                )
        pane.set(
            xscale="log",
            yscale="log",
            xlim=(0.11, 0.8),
            ylim=(0.6, 0.009),
            title="garments trained on" if trained else "a stranger's T-shirt",
        )
        pane.set_xlabel("time of a frame, skinning with push-out = 1")
        pane.set_xticks([0.15, 0.2, 0.3, 0.5, 0.7], ["0.15", "0.2", "0.3", "0.5", "0.7"], minor=False)
        pane.minorticks_off()
        pane.set_yticks([0.5, 0.2, 0.1, 0.05, 0.02, 0.01], ["0.50", "0.80", "0.90", "0.95", "0.98", "0.99"])
        pane.grid(alpha=0.25)
    panes[0].set_ylabel("gain, 1 = physics")
    figure.tight_layout()
    figure.savefig(PICTURE, dpi=110)


if __name__ == "__main__":
    main()
