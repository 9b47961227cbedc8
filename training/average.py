"""A model between two, of which one went on from the other.

    python -m training.average runs/shipped/checkpoint.pt runs/longer/checkpoint.pt --out runs/between/checkpoint.pt

Every weight is the mean of both (Wortsman et al., Robust fine-tuning of zero-shot models, 2022). On the way between a
model and what it was trained on to, energies fall and the drape moves as smoothly as before for longer than at its end
(docs/log.md); both have to drape in the same basin, so this is only for weights that came one from the other.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from drape.errors import InputError, refusing
from training import checkpoint
from training.starting import read_model


def interpolate_weights(first: dict[str, Tensor], second: dict[str, Tensor], share: float) -> dict[str, Tensor]:
    """Returns the weights by name that lie ``share`` of the way from ``first`` to ``second``. What is no floating point
    number is that of ``second``.

    Raises ``InputError`` for models of different sizes and for a share outside [0, 1].
    """
    if not 0.0 <= share <= 1.0:
        raise InputError("--share", expected="a number from 0 to 1", got=f"{share:g}", cure="Take 0.5.")
    strange = [
        name
        for name in sorted(first.keys() | second.keys())
        if name not in first or name not in second or first[name].shape != second[name].shape
    ]
    if strange:
        raise InputError(
            "models to average",
            expected="the same network twice",
            got=f"{strange[0]} in one of them alone, or of two sizes",
            cure="Take a model and what it was trained on to.",
        )
    return {
        name: torch.lerp(first[name], value, share) if value.is_floating_point() else value
        for name, value in second.items()
    }


def average(first: Path, second: Path, out: Path, *, share: float = 0.5) -> None:
    """Writes the checkpoint ``out``. Its weights lie ``share`` of the way from the model ``first`` to the checkpoint
    ``second``; configuration, steps and time are those of ``second``.

    ``first`` may be an exported model, of which the static network is read. Raises ``InputError`` as
    ``interpolate_weights`` does.
    """
    payload, config = checkpoint.load_checkpoint(second)
    weights = interpolate_weights(read_model(first)[0], payload["model"], share)
    progress: dict[str, Any] = {name: payload[name] for name in ("step", "frames", "elapsed_s") if name in payload}
    checkpoint.save(out, {"model": weights, **progress}, config)


@refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Writes the checkpoint ``--out``, whose weights lie between those of two others. Returns 0, or 2 after a refusal,
    whose sentence it prints."""
    parser = argparse.ArgumentParser(prog="python -m training.average", description="A model between two.")
    parser.add_argument("first", type=Path, help="checkpoint, or a model, as of training.run --finetune")
    parser.add_argument("second", type=Path, help="checkpoint of what the first was trained on to")
    parser.add_argument("--share", type=float, default=0.5, help="of the way to the second")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args(arguments)
    average(options.first, options.second, options.out, share=options.share)
    return 0


if __name__ == "__main__":
    sys.exit(main())
