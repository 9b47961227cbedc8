"""The intake of one file in a process with limits: ``python -m service.uploads.sandbox FILE --out DIR``.

Strangers' files are never parsed in the serving process, because a mesh file of a few hundred bytes can make a reader
take gigabytes.

Standard input holds, for a garment, the body that it was modelled on, or nothing where the intake shall find it; with
``--kind avatar`` JSON with the ``joints`` and ``parts`` that a client named and ``alive``, whether its clothes become
garments, or nothing; with ``--kind motion`` the name of a clip, or nothing for the longest.

Standard output has lines of JSON: ``{"stage": NAME}`` when a stage begins, and as the last line ``{"problem": {kind,
name, expected, got, cure}}`` or ``{"files": [NAME, ...]}``. The files are the garments, the innermost first; or the
motion; or the avatar and then the garments of its own clothes, with ``stiff``: why others did not become garments.
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
MOST_PROCESSES = 2  # an intake shares its longest steps with a copy of itself, which has the same limits
MOST_FRAMES = 36_000  # the most of a motion: twenty minutes at 30 a second
CURE = "Export it again."
NO_STACK = os.strerror(errno.EAGAIN)  # the error of a C++ library where a thread of its own gets no memory


class Thing(NamedTuple):
    """The words of refusals of one kind of file: its name in ``words``, the class of the ``refusal`` of a file that
    cannot be read, and the cure for one that is too large (``smaller``)."""

    words: str
    refusal: type[DrapeError]
    smaller: str


THINGS = {
    "garment": Thing("a mesh", MeshError, "Simplify the mesh."),
    "avatar": Thing("a character", MeshError, "Simplify the mesh."),
    "motion": Thing("a motion", MotionError, "Cut it, or export it at a lower rate."),
}


def set_limits(*, memory_mb: int, cpu_s: int) -> None:
    """Limits this process to an address space of ``memory_mb`` [MiB], ``cpu_s`` [s] of processor time and files of
    ``FILE_LIMIT_BYTES``, and forbids core dumps."""
    memory = memory_mb * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 2))
    resource.setrlimit(resource.RLIMIT_FSIZE, (FILE_LIMIT_BYTES, FILE_LIMIT_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _take_buffers() -> None:
    """Makes BLAS allocate its buffers before memory is limited. It would end the process without a message where it
    cannot."""
    import numpy as np
    from scipy.linalg import get_blas_funcs

    square = np.ones((256, 256))
    np.dot(square, square)
    (gemm,) = get_blas_funcs(("gemm",), (square,))  # SciPy has a BLAS of its own
    gemm(1.0, square, square)


def intake_files(file: Path, out: Path, *, avatar: str | None, body: str) -> list[str]:
    """Takes the garments of the mesh ``file`` in and writes their caches to ``out``. Returns the file names of the
    caches, the innermost garment first. ``avatar`` is the body that they were modelled on, None where the intake finds
    it; ``body`` is the name of the standard body."""
    from drape.body.assets import load_body
    from drape.garment.intake import intake_outfit

    garments = intake_outfit(file, avatar=avatar, body=load_body(body), folder=out, quick=True, begun=_print_stage)
    return [garment.file_name() for garment in garments]


def avatar_files(file: Path, out: Path, *, meaning: str | None, body: str) -> tuple[list[str], dict[str, str] | None]:
    """Takes the character in ``file`` in and writes its wearer to ``out``. ``meaning`` (``Accepted.avatar``) may ask
    for its own clothes; their caches are written too.

    Returns the names of the files, that of the wearer first, and the clothes that did not become garments: a dict with
    the names of their parts as keys and the reasons as values, None if ``meaning`` does not ask for clothes.
    """
    from drape.avatar.own_garments import own_garments
    from drape.avatar.wearer import read_wearer, save_wearer, wearer_name
    from drape.body.assets import load_body
    from drape.garment.cache import save_garment

    named, payload = json.loads(meaning) if meaning else {}, file.read_bytes()
    wearer = read_wearer(
        payload, name=wearer_name(file.stem), body=load_body(body), joints=named.get("joints"),
        kinds=named.get("parts"), begun=_print_stage,
    )  # fmt: skip
    stored = save_wearer(wearer, out)  # before the clothes are made: the service reads it meanwhile
    if not named.get("alive"):
        return [stored.name], None
    _print_stage("cloth")
    own = own_garments(payload, wearer)
    _print_stage("store")
    caches = [save_garment(garment, out, quick=True) for garment in own.garments]
    return [path.name for path in (stored, *caches)], own.stiff


def motion_file(file: Path, out: Path, *, clip: str | None) -> Path:
    """Writes the clip called ``clip``, None for the longest, of the motion ``file`` to ``out`` as ``MotionClip.save``
    does. Returns the path. Raises ``TooLarge`` for more than ``MOST_FRAMES`` frames."""
    from drape.motion.readers import read_motion

    motion = read_motion(file, clip=clip, most_frames=MOST_FRAMES)
    path = out / "motion.npz"
    motion.save(path)
    return path


def _print_stage(stage: str) -> None:
    print(json.dumps({"stage": stage}), flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Takes one file in as ``arguments``, those of the command line by default, say. Returns the exit status: 0, or 2
    after a refusal."""
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
        # Libraries are loaded when they are used, so an import that fails is also for want of memory.
        if isinstance(error, (MemoryError, ImportError)) or str(error) == NO_STACK:
            expected, cure = f"{thing.words} that fits into {options.memory_mb} MB", thing.smaller
        else:  # a fault of ours that this file has brought to light; the client can only change the file
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
