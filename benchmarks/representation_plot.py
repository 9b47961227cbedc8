"""The trade of numbers against energy as a picture: one panel per garment, one line per form of patch."""

from __future__ import annotations

from pathlib import Path
from typing import Any

LABELS = {
    "paper": "paper (height, shift, scale; skinned)",
    "paper_turning": "paper + free turn",
    "skinned_2": "in-plane order 2, skinned",
    "rigid_1": "in-plane order 1, rigid frames",
    "rigid_2": "in-plane order 2, rigid frames",
    "rigid_3": "in-plane order 3, rigid frames",
    "agreeing": "order 2, charts agreeing",
}


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Draws 1 - gain of every form over the numbers that a posed garment needs, into the PNG ``path``."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    garments = list(dict.fromkeys(row["garment"] for row in rows))
    figure, axes = pyplot.subplots(
        1, len(garments), figsize=(4.6 * len(garments), 4.2), sharey=True, squeeze=False, layout="constrained"
    )
    for axis, garment in zip(axes[0], garments, strict=True):
        for place, (method, label) in enumerate(LABELS.items()):
            own = [row for row in rows if row["garment"] == garment and row["method"] == method]
            own.sort(key=lambda row: row["patches"])
            if own:
                axis.plot(
                    [row["patches"] * row["numbers"] for row in own],
                    [max(1.0 - row["gain"], 1e-4) for row in own],
                    marker="osD^vPX"[place],
                    color=f"C{place}",
                    label=label,
                )
        axis.set(title=garment, xlabel="numbers per frame (patches x numbers each)", xscale="log", yscale="log")
        axis.grid(True, which="both", alpha=0.3)
    axes[0, 0].set_ylabel("energy above the optimum (1 - gain)")
    axes[0, -1].legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
