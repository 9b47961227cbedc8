"""A process beside an intake and under its limits, for half of what takes long: ``python -m service.uploads.beside``.

It reads a function and a list, pickled, from its standard input and answers with what the function makes of each. Both
processes have seen the same stranger's file and may do the same, so neither need distrust the other.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from drape.errors import TooLarge
from service.compute.background import end_with_parent, step_back

Each = Callable[[Callable[[Any], Any], Sequence[Any]], list[Any]]


@contextmanager
def beside() -> Iterator[Each]:
    """A ``map`` of two processes, the first thing here and the others there; begin it before it is needed."""
    command = [sys.executable, "-m", "service.uploads.beside"]  # in the session of this one, and ended with it
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin is not None and process.stdout is not None
    into, out = process.stdin, process.stdout

    def each(make: Callable[[Any], Any], ones: Sequence[Any]) -> list[Any]:
        if len(ones) < 2:
            return [make(one) for one in ones]
        try:
            pickle.dump((make, ones[1:]), into)
            into.flush()
            made = [make(one) for one in ones[:1]]
            others = pickle.load(out)
        except (EOFError, BrokenPipeError) as error:  # by a limit, or by the system
            expected, got = "clothes that fit into the limits of an intake", f"a process that ended: {process.wait()}"
            raise TooLarge("clothes", expected=expected, got=got, cure="Simplify the mesh.") from error
        if isinstance(others, Exception):
            raise others
        return made + others

    try:
        yield each
    finally:
        process.kill()
        process.wait()


def main() -> None:
    end_with_parent()
    step_back()
    import drape.avatar.own_garments  # noqa: F401  so that it is there when it is asked for

    make, ones = pickle.load(sys.stdin.buffer)
    try:
        found: Any = [make(one) for one in ones]
    except Exception as error:
        found = error
    pickle.dump(found, sys.stdout.buffer)
    sys.stdout.flush()


if __name__ == "__main__":
    main()
