"""The process of ``ConstantsProcess``: ``python -m service.compute.constants_calls``.

Calls come in on its standard input, pickled, results go out on its standard output, and it ends where that ends. Arrays
travel beside the pickles, uncopied, with the interpreter lock released. It reads no more of the service than that,
since it starts while an upload runs.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import struct
import sys
from typing import IO, Any

from service.compute.background import step_back

COUNT = struct.Struct("<Q")


def send(file: IO[bytes], thing: Any) -> None:
    """Writes ``thing`` for ``receive``: its pickle, and the memory of its arrays."""
    buffers: list[pickle.PickleBuffer] = []
    parts = [pickle.dumps(thing, protocol=5, buffer_callback=buffers.append), *(one.raw() for one in buffers)]
    file.write(COUNT.pack(len(parts)))
    for part in parts:
        file.write(COUNT.pack(len(part)))
        file.write(part)
    file.flush()


def receive(file: IO[bytes]) -> Any:
    """The thing that ``send`` wrote; ``EOFError`` where nothing more comes."""
    text, *buffers = [_read(file, _number(file)) for _ in range(_number(file))]
    return pickle.loads(text, buffers=buffers)


def _number(file: IO[bytes]) -> int:
    return COUNT.unpack(_read(file, COUNT.size))[0]


def _read(file: IO[bytes], size: int) -> bytearray:
    place = bytearray(size)
    into = memoryview(place)
    while into:
        taken = file.readinto(into)  # pyright: ignore[reportAttributeAccessIssue]
        if not taken:
            raise EOFError
        into = into[taken:]
    return place


def _read_before() -> None:
    """Imports what makes the constants of a garment, before it is called."""
    import drape.graph.feeds
    import drape.live.swing_constants
    import drape.live.two_level  # noqa: F401


def main() -> None:
    """Answers calls, pickled on standard input, until that ends: on standard output, whether each came off, and what
    its function returned or raised."""
    step_back()
    _read_before()
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what is printed is no answer
    with contextlib.suppress(EOFError):
        while True:
            function, arguments, named = receive(sys.stdin.buffer)
            try:
                answer = True, function(*arguments, **named)
            except Exception as error:
                answer = False, error
            send(answers, answer)


if __name__ == "__main__":
    main()
