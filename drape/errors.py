"""The exceptions that a user of the product can meet.

    DrapeError
    |-- InputError            what came in is wrong: a file, a request, an option
    |   |-- MeshError         a mesh cannot be draped
    |   |-- BodyError         a body file or shape is wrong
    |   |-- MotionError       a pose or a clip is wrong
    |   |-- NotFound          a name of something that does not exist
    |   |-- TooLarge          more bytes, frames, layers or vertices than are taken
    |-- ArtifactError         a stored model, cache or asset is damaged or does not fit
    |-- Unavailable           something that this installation or machine lacks

Every message says four things: the name of the offending value, what was
expected, what came, and what cures it. A command that refuses ends with that sentence on standard
error and an exit status that scripts can tell (``refusing``).
"""

from __future__ import annotations

import difflib
import functools
import os
import re
import select
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import ParamSpec

REFUSED_EXIT_CODE = 2
UNREAD_EXIT_CODE = 128 + 13  # The status of a process that SIGPIPE ended.

P = ParamSpec("P")


class DrapeError(Exception):
    """A refusal, and the base of all kinds of refusal.

    ``name`` says what was wrong, ``expected`` what would have been right, ``got`` what came, and ``cure`` what to do.
    ``str()`` is a line with all four.
    """

    def __init__(self, name: str, *, expected: str, got: str, cure: str) -> None:
        self.name = legible(name)
        self.expected = legible(expected)
        self.got = legible(got)
        self.cure = legible(cure)
        super().__init__(f"{self.name}: expected {self.expected}, got {self.got}. {self.cure}")

    def __reduce__(self):
        # Keyword-only arguments do not survive the default pickling, and intake
        # sends its errors across a process boundary.
        return _rebuild, (type(self), self.name, self.expected, self.got, self.cure)


def _rebuild(kind: type[DrapeError], name: str, expected: str, got: str, cure: str) -> DrapeError:
    return kind(name, expected=expected, got=got, cure=cure)


def legible(text: str) -> str:
    """Returns a stranger's ``text`` for a line of a log, JSON or a header. What cannot be printed is escaped, as half a
    pair of UTF-16 or the end of a line."""
    return text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


class InputError(DrapeError):
    """Input of the caller that is wrong: a file, a request or an option."""


class MeshError(InputError):
    """A mesh that cannot be draped."""


class BodyError(InputError):
    """A body file, shape or registration that cannot be used."""


class MotionError(InputError):
    """A pose, a clip or a motion file that cannot be used."""


class NotFound(InputError):
    """A name of something that does not exist here."""


class TooLarge(InputError):
    """More bytes, frames, layers or vertices than are taken."""


class ArtifactError(DrapeError):
    """A stored model, cache or asset that is damaged or does not fit."""


class Unavailable(DrapeError):
    """Something that this installation or machine lacks, such as a package."""


def while_read(main: Callable[P, int]) -> Callable[P, int]:
    """Returns the ``main`` of a command wrapped so that it ends silently where nobody reads its output any more, as
    behind a pipe to ``head``. It then returns the exit status of SIGPIPE, 141."""

    @functools.wraps(main)
    def written(*args: P.args, **kwargs: P.kwargs) -> int:
        try:
            status = main(*args, **kwargs)
            sys.stdout.flush()
            return status
        except BrokenPipeError:
            look = select.poll()
            look.register(sys.stdout.fileno())
            if not any(event & select.POLLERR for _, event in look.poll(0)):
                raise  # It was another pipe.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes once more at its end.
            return UNREAD_EXIT_CODE

    return written


def refusing(main: Callable[P, int]) -> Callable[P, int]:
    """Returns the ``main`` of a command wrapped so that a refusal (``DrapeError``) prints its sentence to standard
    error and returns the exit status 2. The wrapped function also does what ``while_read`` does."""

    @while_read
    @functools.wraps(main)
    def guarded(*args: P.args, **kwargs: P.kwargs) -> int:
        try:
            return main(*args, **kwargs)
        except DrapeError as error:
            print(error, file=sys.stderr)
            return REFUSED_EXIT_CODE

    return guarded


def exit_status(main: Callable[[], object]) -> int:
    """Runs the ``main`` of a command, whose result does not count, and returns its exit status: 0, or 2 after the
    sentence of a refusal. It also does what ``while_read`` does."""

    def run() -> int:
        main()
        return 0

    return refusing(run)()


def with_numbers_bound(arguments: Sequence[str] | None) -> list[str]:
    """Returns the command line ``arguments``, by default those of the process, with lists of numbers bound to their
    options: "--betas", "-1,0.5" becomes "--betas=-1,0.5", for ``argparse`` takes that minus for an option's."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    for place in range(len(words) - 2, -1, -1):
        option, value = words[place : place + 2]
        if re.fullmatch(r"--\w[^=]*", option) and re.fullmatch(r"-[\d.][^=]*[,e].*", value, re.IGNORECASE):
            words[place : place + 2] = [f"{option}={value}"]
    return words


def did_you_mean(name: str, known: Iterable[str], cure: str) -> str:
    """Returns ``cure``. If a name in ``known`` is similar to ``name``, the question whether that one was meant comes
    first."""
    by_lower = {one.lower(): one for one in known}
    near = difflib.get_close_matches(name[:120].lower(), by_lower, n=1, cutoff=0.7)
    return f"Did you mean {by_lower[near[0]]}? {cure}" if near else cure
