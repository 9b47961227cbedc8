"""python -m model_export CHECKPOINT drape/assets/models/NAME: a checkpoint as a model folder that the service loads.

    python -m model_export --quality benchmarks/results/quality.json drape/assets/models/NAME

without a checkpoint writes the measured quality into the manifest of a folder that stands;

    python -m model_export --push-out drape/assets/models/NAME

the graph of the push-out, which is the same for every network.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from drape.errors import refusing
from drape.garment.cache import GARMENTS_DIR, load_garment
from model_export.export import command_line, commit, export, load_model, static_training
from model_export.folder import add_push_out, write_quality


@refusing
def main() -> int:
    """Runs the command line. Returns 0, or 2 after a refusal, whose sentence it prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("checkpoint", type=Path, nargs="?")
    parser.add_argument("target", type=Path)
    parser.add_argument("--quality", type=Path, help="JSON of benchmarks.quality whose rows go into the manifest")
    parser.add_argument("--push-out", action="store_true", help="write the push-out into a folder that stands")
    parser.add_argument("--garment", type=Path, help="garment cache for the parity check; default the shipped T-shirt")
    arguments = parser.parse_args()
    rows = json.loads(arguments.quality.read_text())["rows"] if arguments.quality else None
    if arguments.checkpoint is None and not arguments.push_out:
        if rows is None:
            parser.error("give a checkpoint to export, or --quality or --push-out for a folder that stands")
        write_quality(arguments.target, rows)
        print(f"{arguments.target}: {len(rows)} rows of quality")
        return 0
    path = arguments.garment or next(iter(sorted(GARMENTS_DIR.glob("tshirt-*.npz"))), None)
    if path is None:
        parser.error("no shipped T-shirt found: give --garment")
    if arguments.checkpoint is None:
        manifest = add_push_out(arguments.target, load_garment(path))
        print(f"{arguments.target}: push-out written, digest {manifest.digest[:16]}")
        return 0
    model, training = load_model(arguments.checkpoint)
    print(
        f"writing {arguments.target}: its graphs and their comparison with torch take a minute or two of one core",
        flush=True,
    )
    manifest = export(
        model,
        arguments.target,
        garment=load_garment(path),
        training=training | {"commit": commit(), "command": command_line()} | static_training(model, arguments.target),
        quality=rows,
    )
    print(f"{arguments.target}: parity {manifest.parity_error_m:.2e} m, digest {manifest.digest[:16]}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
