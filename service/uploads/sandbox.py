"""One intake in a process with limits: ``python -m service.uploads.sandbox FILE --out DIR``; prints lines of JSON.

Standard input holds the avatar of a garment, or nothing where the standard body is meant; with ``--kind avatar`` the
``joints`` and ``parts`` that were told, and whether its clothes are ``alive``, as JSON, or nothing; with ``--kind
motion`` the name of a clip, or nothing for the longest. ``{"stage": NAME}`` is a line before, for each stage as it
begins. A mesh file of a few hundred bytes can ask for gigabytes, so strangers' files are never parsed in the serving
process. The last line is ``{"problem": {kind, name, expected, got, cure}}``, or ``{"files": [NAME, ...]}``: the
garments of the file, the innermost first, or the motion, or the avatar and then the garments that it came in, with
``stiff``: why others of its clothes are none.
"""

from __future__ import annotations

import argparse
import errno
import json
import os
import resource
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from drape.errors import DrapeError, MeshError, MotionError
from drape.forked import end_with_parent, may_fork
from service.compute.background import processor_count, step_back

FILE_LIMIT_BYTES = 2**30
MOST_PROCESSES = 2  # of one intake, each with its limits: a copy of it has half of what takes long
MOST_FRAMES = 36_000  # of a motion: twenty minutes at 30 a second
CURE = "Export it again."
NO_STACK = os.strerror(errno.EAGAIN)  # what a library in C++ says where a thread of its own gets no memory


class Thing(NamedTuple):
    """A kind of file in words, the refusal of one that cannot be read, and the cure of one that is too large."""

    words: str
    refusal: type[DrapeError]
    smaller: str


THINGS = {
    "garment": Thing("a mesh", MeshError, "Simplify the mesh."),
    "avatar": Thing("a character", MeshError, "Simplify the mesh."),
    "motion": Thing("a motion", MotionError, "Cut it, or export it at a lower rate."),
}


def set_limits(*, memory_mb: int, cpu_s: int) -> None:
    """Limits the address space, the processor time and the size of files of this process, and forbids core dumps."""
    memory = memory_mb * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 2))
    resource.setrlimit(resource.RLIMIT_FSIZE, (FILE_LIMIT_BYTES, FILE_LIMIT_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _take_buffers() -> None:
    """Has BLAS take its buffers: where a limit leaves no room for them, it ends the process without a word."""
    import numpy as np
    from scipy.linalg import get_blas_funcs

    square = np.ones((256, 256))
    np.dot(square, square)
    (gemm,) = get_blas_funcs(("gemm",), (square,))  # of scipy, which has a BLAS of its own
    gemm(1.0, square, square)


def intake_files(file: Path, out: Path, *, avatar: str | None, body: str) -> list[str]:
    """The names of the cache files that the intake makes of ``file``, one for each garment in it."""
    from drape.body.assets import load_body
    from drape.garment.intake import intake_outfit

    made = intake_outfit(file, avatar=avatar, body=load_body(body), folder=out, quick=True, begun=_say)
    return [garment.file_name() for garment in made]


def avatar_files(file: Path, out: Path, *, meaning: str | None, body: str) -> tuple[list[str], dict[str, str] | None]:
    """The names of the file of the wearer that the character in ``file`` becomes, and of those of its own clothes; why
    others of these are no cloth, None where nobody asked for them."""
    from drape.avatar.own_garments import own_garments
    from drape.avatar.wearer import read_wearer, save_wearer, wearer_name
    from drape.body.assets import load_body
    from drape.garment.cache import save_garment

    named, payload = json.loads(meaning) if meaning else {}, file.read_bytes()
    wearer = read_wearer(
        payload, name=wearer_name(file.stem), body=load_body(body), told=named.get("joints"),
        kinds=named.get("parts"), begun=_say,
    )  # fmt: skip
    stored = save_wearer(wearer, out)  # before its clothes: the service looks at it meanwhile
    if not named.get("alive"):
        return [stored.name], None
    _say("cloth")
    own = own_garments(payload, wearer)
    _say("store")
    return [path.name for path in (stored, *(save_garment(one, out, quick=True) for one in own.garments))], own.stiff


def motion_file(file: Path, out: Path, *, clip: str | None) -> Path:
    """The file of the clip called ``clip`` in the motion ``file``, or of its longest, as ``MotionClip.save`` writes it.

    Raises ``TooLarge`` for more than ``MOST_FRAMES`` frames.
    """
    from drape.motion.readers import read_motion

    motion = read_motion(file, clip=clip, most_frames=MOST_FRAMES)
    path = out / "motion.npz"
    motion.save(path)
    return path


def _say(stage: str) -> None:
    print(json.dumps({"stage": stage}), flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Takes one file in, as the ``arguments``, or those of the command line, say; returns the status to end with."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--body", required=True)
    parser.add_argument("--kind", choices=tuple(THINGS), default="garment")
    parser.add_argument("--memory-mb", type=int, required=True)
    parser.add_argument("--cpu-s", type=int, required=True)
    options = parser.parse_args(arguments)
    end_with_parent()
    step_back()
    _take_buffers()
    set_limits(memory_mb=options.memory_mb, cpu_s=options.cpu_s)
    may_fork(min(MOST_PROCESSES, processor_count()) - 1)
    try:
        meaning = sys.stdin.buffer.read().decode() or None
        stiff = None
        if options.kind == "avatar":
            files, stiff = avatar_files(options.file, options.out, meaning=meaning, body=options.body)
        elif options.kind == "motion":
            files = [motion_file(options.file, options.out, clip=meaning).name]
        else:
            files = intake_files(options.file, options.out, avatar=meaning, body=options.body)
    except DrapeError as error:
        return _refuse(options.out, error)
    except Exception as error:
        thing, got = THINGS[options.kind], "one that does not"
        # Libraries are read as they are wanted: what says that it cannot be has no room to be in.
        if isinstance(error, (MemoryError, ImportError)) or str(error) == NO_STACK:
            expected, cure = f"{thing.words} that fits into {options.memory_mb} MB", thing.smaller
        else:  # a fault of ours that a strange file found: whoever sent it is told of the file
            expected, got, cure = f"{thing.words} that can be read", f"one at which it fails: {error!r}"[:120], CURE
        return _refuse(options.out, thing.refusal(options.file.name, expected=expected, got=got, cure=cure))
    print(json.dumps({"files": files} | ({} if stiff is None else {"stiff": stiff})))
    return 0


def _refuse(out: Path, error: DrapeError) -> int:
    shutil.rmtree(out, ignore_errors=True)
    problem = {
        "kind": type(error).__name__,
        "name": error.name,
        "expected": error.expected,
        "got": error.got,
        "cure": error.cure,
    }
    print(json.dumps({"problem": problem}))
    return 2


if __name__ == "__main__":
    sys.exit(main())
