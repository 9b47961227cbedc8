"""Arrays in one file packed by LZMA, which ``numpy.load`` reads, and files that a reader never sees half written."""

from __future__ import annotations

import contextlib
import io
import json
import lzma
import os
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drape.errors import Unavailable

UNREADABLE = (
    OSError,
    ValueError,
    TypeError,  # a bare .npy is an array, which no `with` takes
    AttributeError,  # a header that is no object
    KeyError,
    EOFError,
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
)
"""The exceptions that reading a damaged npz raises, or a file that is none."""


def packed(arrays: Mapping[str, np.ndarray]) -> bytes:
    """The bytes of an npz of ``arrays``. The same arrays have the same bytes: members bear no time."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_LZMA) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)
    return buffer.getvalue()


def read_packed(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The JSON object in the bytes of the array ``header`` of the npz at ``path``, and its other arrays by name.

    Raises one of ``UNREADABLE`` where there is no such file.
    """
    with np.load(path, allow_pickle=False) as stored:
        header = json.loads(bytes(stored["header"]).decode())
        return header, {key: stored[key] for key in stored.files if key != "header"}


def write_whole(path: Path, content: bytes) -> None:
    """Writes ``content`` to ``path``: a reader sees the old file or the new one, never a part.

    Makes the folder where there is none. Raises ``Unavailable`` where it cannot be written.
    """
    temporary = path.with_name(path.name + f".{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(content)
        os.replace(temporary, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        got = str(error.strerror or error)
        raise Unavailable(
            str(path.parent), expected="a folder that can be written", got=got, cure="Choose another folder."
        ) from error
