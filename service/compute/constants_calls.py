"""The program of ``ConstantsProcess``: ``python -m service.compute.constants_calls``.

It reads pickled calls from its standard input and writes their results to its standard output, until the input ends.
Arrays travel beside the pickles, uncopied, with the interpreter lock released. It imports little of the service,
because it starts while an upload runs.
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
    """Writes ``thing`` to ``file`` as ``receive`` reads it: its pickle, and the memory of its arrays beside it."""
    buffers: list[pickle.PickleBuffer] = []
    parts = [pickle.dumps(thing, protocol=5, buffer_callback=buffers.append), *(array.raw() for array in buffers)]
    file.write(COUNT.pack(len(parts)))
    for part in parts:
        file.write(COUNT.pack(len(part)))
        file.write(part)
    file.flush()


def receive(file: IO[bytes]) -> Any:
    """Returns the next object that ``send`` wrote to ``file``. Raises ``EOFError`` at its end."""
    text, *buffers = [_read(file, _number(file)) for _ in range(_number(file))]
    return pickle.loads(text, buffers=buffers)


def _number(file: IO[bytes]) -> int:
    return COUNT.unpack(_read(file, COUNT.size))[0]


def _read(file: IO[bytes], size: int) -> bytearray:
    content = bytearray(size)
    rest = memoryview(content)
    while rest:
        count = file.readinto(rest)  # pyright: ignore[reportAttributeAccessIssue]
        if not count:
            raise EOFError
        rest = rest[count:]
    return content


def _import_early() -> None:
    """Imports the modules that make the constants of a garment, so that the first call need not wait for them."""
    import drape.graph.feeds
    import drape.live.swing_constants
    import drape.live.two_level  # noqa: F401


def main() -> None:
    """Answers calls (function, arguments, named arguments) from standard input until that ends. An answer on standard
    output is (True, what the function returned) or (False, the exception that it raised)."""
    step_back()
    _import_early()
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # so that no printed text gets between the answers
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
