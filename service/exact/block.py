"""The frames of a clip of tier exact, each from the one before it, in a process of their own.

``python -m service.exact.block`` reads a pickled ``FrameBlock`` on its standard input and prints a line of JSON for
each frame as it is on disk, ``{"frame": 12, ...}``, or ``{"problem": {kind, name, expected, got, cure}}`` as its last
one. Frames that are on disk are left as they are.
"""

from __future__ import annotations

import json
import os
import pickle
import resource
import sys
from dataclasses import asdict, dataclass
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
    """The frames of a clip, with the ``poses`` (n, 24, 3) [rad] and the ``starts`` [m] (n, V, 3) that they are given,
    relative to the root; ``rest`` [m] (V, 3) is a drape of the T-pose. They go to ``folder``."""

    garment: Garment
    fabric: Fabric
    model: BodyModel
    betas: np.ndarray
    rest: np.ndarray
    folder: Path
    poses: np.ndarray
    starts: np.ndarray


def run_block(block: FrameBlock, say: Any = print) -> None:
    """Computes the frames of ``block`` that are not on disk, one after the other, and calls ``say`` with the figures of
    each."""
    sheet, before = None, None
    for number, (pose, start) in enumerate(zip(block.poses, block.starts, strict=True)):
        kept = read_frame(block.folder, number)
        if kept is None:
            if sheet is None:
                sheet = ExactCloth.of(block.garment, block.fabric, block.model, block.betas, block.rest)
            before, told = exact(sheet, pose, start, before)
            write_frame(block.folder, number, before.x.astype(np.float32), asdict(told))
            say(json.dumps({"frame": number, **asdict(told)}), flush=True)
        else:
            before = RestingFrame(pose, kept[0].astype(np.float64), start.astype(np.float64))


def main() -> int:
    end_with_parent()
    step_back()
    memory = int(sys.argv[1]) * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what is printed is no answer

    def say(line: str, *, flush: bool = True) -> None:
        answers.write(line + "\n")
        answers.flush()

    try:
        with sys.stdin.buffer as given:  # a file, whose room is free from then on
            block = pickle.load(given)
        run_block(block, say)
    except DrapeError as error:
        return _refuse(say, error)
    except MemoryError:
        cure = "Raise DRAPE_INTAKE_MEMORY_MB, or ask for fewer vertices."
        got = "one that does not"
        return _refuse(say, Unavailable("memory", expected=f"a frame within {sys.argv[1]} MB", got=got, cure=cure))
    except OSError as error:
        cure = "Make room, and ask again."
        return _refuse(say, Unavailable("disk", expected="room for a frame", got=str(error.strerror), cure=cure))
    return 0


def _refuse(say: Any, error: DrapeError) -> int:
    said = {"name": error.name, "expected": error.expected, "got": error.got, "cure": error.cure}
    say(json.dumps({"problem": {"kind": type(error).__name__, **said}}))
    return 2


if __name__ == "__main__":
    sys.exit(main())
