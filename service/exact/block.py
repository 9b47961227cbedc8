"""The program that computes the frames of a clip of tier exact, each from the one before it.

``python -m service.exact.block`` reads a pickled ``FrameBlock`` from its standard input. It prints a line of JSON for
each frame that it has written, ``{"frame": 12, ...}``, and ``{"problem": {kind, name, expected, got, cure}}`` as the
last line after a refusal. Frames that were on disk before are not computed again.
"""

from __future__ import annotations

import json
import os
import pickle
import resource
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.fabric import Fabric
from drape.errors import DrapeError, Unavailable
from drape.exact.frame import ExactCloth, RestingFrame, exact
from drape.forked import end_with_parent
from drape.garment.cache import Garment
from service.compute.background import step_back
from service.exact.clip_folder import read_frame, write_frame


@dataclass(frozen=True, eq=False)
class FrameBlock:
    """All that the frames of a clip are computed from, and the ``folder`` that they are written to.

    ``poses`` (F, 24, 3) [rad]; ``starts`` [m] (F, V, 3), the drapes of tier accurate that the frames start from;
    ``rest`` [m] (V, 3), a drape of the T-pose; ``betas`` (S,), the shape of ``model``. Drapes are relative to the root
    joint, in the world's axes.
    """

    garment: Garment
    fabric: Fabric
    model: BodyModel
    betas: np.ndarray
    rest: np.ndarray
    folder: Path
    poses: np.ndarray
    starts: np.ndarray


def run_block(block: FrameBlock, print_line: Callable[[str], Any] = print) -> None:
    """Computes the frames of ``block`` that are not on disk, one after the other, and writes each to the folder. Calls
    ``print_line`` after each with the text of a JSON object: its number as ``frame``, and its ``FIGURES``."""
    sheet, before = None, None
    for number, (pose, start) in enumerate(zip(block.poses, block.starts, strict=True)):
        stored = read_frame(block.folder, number)
        if stored is None:
            if sheet is None:
                sheet = ExactCloth.of(block.garment, block.fabric, block.model, block.betas, block.rest)
            before, figures = exact(sheet, pose, start, before)
            write_frame(block.folder, number, before.x.astype(np.float32), asdict(figures))
            print_line(json.dumps({"frame": number, **asdict(figures)}))
        else:
            before = RestingFrame(pose, stored[0].astype(np.float64), start.astype(np.float64))


def main() -> int:
    end_with_parent()
    step_back()
    memory = int(sys.argv[1]) * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # so that no printed text gets between the answers
    print_answer = partial(print, file=answers, flush=True)
    try:
        with sys.stdin.buffer as request:  # a file without a name, whose room on disk is free once it is closed
            block = pickle.load(request)
        run_block(block, print_answer)
        return 0
    except DrapeError as error:
        refusal = error
    except MemoryError:
        cure, got = "Raise DRAPE_INTAKE_MEMORY_MB, or ask for fewer vertices.", "one that does not fit"
        refusal = Unavailable("memory", expected=f"a frame within {sys.argv[1]} MB", got=got, cure=cure)
    except OSError as error:
        cure = "Make room, and ask again."
        refusal = Unavailable("disk", expected="room for a frame", got=str(error.strerror), cure=cure)
    words = {"name": refusal.name, "expected": refusal.expected, "got": refusal.got, "cure": refusal.cure}
    print_answer(json.dumps({"problem": {"kind": type(refusal).__name__, **words}}))
    return 2


if __name__ == "__main__":
    sys.exit(main())
