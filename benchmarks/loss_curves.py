"""Curves of training runs as a picture, from what they wrote for TensorBoard.

    python -m benchmarks.loss_curves runs/shipped runs/longer --out docs/images/loss_curves.png

One panel per part of the loss, one line per run: medians over ``WINDOW`` records, since every record is of other
garments and poses.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.common import ROOT
from drape.errors import InputError, refusing

PARTS = {
    "membrane": "membrane [J/m2]",
    "bending": "bending [J/m2]",
    "contact": "contact [J/m2]",
    "disagreement_mm": "charts apart, RMS [mm]",
}
WINDOW = 15
OUT = ROOT / "docs" / "images" / "loss_curves.png"


def curves(run: Path) -> dict[str, np.ndarray]:
    """Steps and values (n, 2) of every part that the ``run`` wrote, the last ones of steps that it took twice."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    log = run / "log"
    if not log.is_dir():
        raise InputError(
            "run", expected="a folder of training.run with its log", got=run.name, cure="Train with --out."
        )
    events = EventAccumulator(str(log))
    events.Reload()
    there = set(events.Tags()["scalars"])
    found = {}
    for part in PARTS:
        by_step = {event.step: event.value for event in events.Scalars(part)} if part in there else {}
        found[part] = np.array(sorted(by_step.items()), dtype=np.float64).reshape(-1, 2)
    return found


def smooth(curve: np.ndarray, window: int = WINDOW) -> np.ndarray:
    """Medians (m, 2) of ``window`` neighbouring rows of ``curve`` (n, 2); all of it where it is shorter."""
    size = min(window, len(curve))
    if size == 0:
        return curve
    return np.median(np.lib.stride_tricks.sliding_window_view(curve, size, axis=0), axis=-1)


def plot(runs: Sequence[Path], out: Path) -> None:
    """Draws the curves of ``runs`` into the PNG ``out``."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    found = {run.name: curves(run) for run in runs}
    figure, axes = pyplot.subplots(1, len(PARTS), figsize=(4.0 * len(PARTS), 3.2), layout="constrained")
    for axis, (part, label) in zip(axes, PARTS.items(), strict=True):
        for name, parts in found.items():
            if len(parts[part]):
                axis.plot(*smooth(parts[part]).T, label=name, linewidth=1.2)
        axis.set(title=label, xlabel="steps", yscale="log")
        axis.grid(True, which="both", alpha=0.3)
    axes[0].legend(fontsize=8)
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=90)
    pyplot.close(figure)


@refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Command line entry."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.loss_curves", description="Curves of training runs.")
    parser.add_argument("runs", nargs="+", type=Path, help="folders of training.run")
    parser.add_argument("--out", type=Path, default=OUT)
    given = parser.parse_args(arguments)
    plot(given.runs, given.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
