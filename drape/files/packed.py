"""Arrays in one packed file, which ``numpy.load`` reads too."""

from __future__ import annotations

import io
import json
import lzma
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

UNREADABLE = (
    OSError,
    ValueError,
    TypeError,  # A bare .npy is an array, which no `with` takes.
    AttributeError,  # A header may be no object.
    KeyError,
    EOFError,
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
)
"""The exceptions that reading a damaged npz raises, or a file that is none."""


def pack(arrays: Mapping[str, np.ndarray], *, quick: bool = False) -> bytes:
    """Returns the bytes of an npz with ``arrays``, compressed by LZMA, or where ``quick`` by deflate: a fifth larger,
    in a tenth of the time. The same arrays give the same bytes, since members carry no time."""
    buffer = io.BytesIO()
    kind, level = (zipfile.ZIP_DEFLATED, 1) if quick else (zipfile.ZIP_LZMA, None)
    with zipfile.ZipFile(buffer, "w", kind, compresslevel=level) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)
    return buffer.getvalue()


def read_packed(path: Path, *, part: str = "") -> tuple[dict[str, Any], dict[str, Any]]:
    """Returns the JSON object in the array ``header`` of the npz at ``path``, and the other arrays by name.

    Without ``part`` only arrays are read whose names have no dot. With it only those, header included, that are called
    PART.NAME; the result has them by NAME. Raises one of ``UNREADABLE`` where the file is missing or damaged.
    """
    with np.load(path, allow_pickle=False) as stored:
        keys = {key.rpartition(".")[2]: key for key in stored.files if key.rpartition(".")[0] == part}
        header = json.loads(bytes(stored[keys.pop("header")]).decode())
        return header, {name: stored[key] for name, key in keys.items()}
