"""What took long to make and depends on nothing but source text, kept on disk beside the source, as kernels are.

The push-out's graphs are the same for every model, and to trace them takes most of an export of a small one.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

_HERE = Path(__file__).parent
_ROOT = _HERE.parents[1]
SOURCES = (_ROOT / "drape", _ROOT / "model_export")  # more than a graph is traced from: too often is no error
EXPORTERS = ("torch", "onnx", "onnxscript", "onnx-ir", "numpy", "array-api-compat")  # whose versions change a graph
FOLDER = _HERE / "__pycache__"
_DIGEST_BYTES = hashlib.sha256().digest_size


def key(sources: Iterable[Path] = SOURCES, packages: Iterable[str] = EXPORTERS) -> str:
    """The hash of every Python file below the folders ``sources``, by its place there, and of versions of packages."""
    found = hashlib.sha256()
    for folder in sources:
        for path in sorted(folder.rglob("*.py")):
            content = hashlib.sha256(path.read_bytes()).hexdigest()
            found.update(f"{folder.name}/{path.relative_to(folder).as_posix()} {content}\n".encode())
    for name in packages:
        found.update(f"{name} {version(name)}\n".encode())
    return found.hexdigest()


def stored(name: str, made_from: str, make: Callable[[], bytes], folder: Path = FOLDER) -> bytes:
    """What ``make`` returned when it was last called for ``name`` and ``made_from``; it is called now where ``folder``
    does not have that, or has it damaged, and what is there of ``name`` by other sources is deleted.

    A folder that cannot be written is no error: everything is then made on every call.
    """
    path = folder / f"{name}.{made_from[:16]}.stored"
    with suppress(OSError):
        found = path.read_bytes()
        content = found[_DIGEST_BYTES:]
        if hashlib.sha256(content).digest() == found[:_DIGEST_BYTES]:
            return content
    content = make()
    with suppress(OSError):
        folder.mkdir(exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, prefix=f"{name}.", suffix=".part", delete=False) as part:
            part.write(hashlib.sha256(content).digest() + content)
        os.replace(part.name, path)  # so that another process reads all of it or nothing
        for old in folder.glob(f"{name}.*.stored"):
            if old != path:
                old.unlink()
    return content
