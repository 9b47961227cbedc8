"""Packed parts of glTF files: KHR_draco_mesh_compression by DracoPy, EXT_meshopt_compression by meshoptimizer.

Both packages are in the extra ``compressed``. Counts are bounded before a decoder sees a byte.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from drape.errors import MeshError
from drape.files.gltf_json import EXPORT, Primitive, excerpt

DRACO, MESHOPT = "KHR_draco_mesh_compression", "EXT_meshopt_compression"
MOST_BYTES = 192 * 2**20
FILTERS = {"OCTAHEDRAL": ("decode_filter_oct", (4, 8)), "QUATERNION": ("decode_filter_quat", (8,))}
FILTERS["EXPONENTIAL"] = ("decode_filter_exp", tuple(range(4, 257, 4)))


def _library(name: str, label: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        cure = f"Install it (pip install {name.lower()}), or export without compression."
        raise MeshError(label, expected=f"the package {name}, which unpacks it", got="none", cure=cure) from error


def draco_parts(payload: bytes, primitive: Primitive, label: str) -> dict[int, np.ndarray]:
    """Returns the rows (N, width) of each accessor of ``primitive`` that its Draco ``payload`` has, by the accessor's
    index. Raises ``MeshError`` where it cannot be unpacked, or DracoPy is not installed."""
    library, ids = _library("DracoPy", label), primitive.extensions[DRACO].get("attributes")
    try:
        mesh = library.decode(payload)
        held = {one["unique_id"]: one["data"] for one in mesh.attributes}
        arrays = {
            primitive.attributes[name]: np.atleast_2d(held[number].T).T
            for name, number in (ids if isinstance(ids, dict) else {}).items()
            if name in primitive.attributes and number in held
        }
        if primitive.indices is not None:
            arrays[primitive.indices] = np.asarray(mesh.faces).reshape(-1, 1)
    except MemoryError:
        raise
    except Exception as error:  # A broken file can raise anything inside the library.
        got = f"{type(error).__name__}: {error}"[:80]
        raise MeshError(label, expected="a mesh that can be unpacked", got=got, cure=EXPORT) from error
    return arrays


def meshopt_view(payload: bytes, entry: dict[str, Any], label: str) -> bytes:
    """Returns the unpacked bytes of a buffer view that is packed as ``payload``. ``entry`` is the view's object of the
    extension EXT_meshopt_compression. Raises ``MeshError`` where it cannot be unpacked, or meshoptimizer is not
    installed."""
    count, stride = (one if type(one := entry.get(key)) is int else 0 for key in ("count", "byteStride"))
    mode, filter_name = entry.get("mode"), entry.get("filter", "NONE")
    wide = mode == "ATTRIBUTES"
    decode, sides = FILTERS.get(filter_name, ("", ())) if isinstance(filter_name, str) else ("", ())
    right = mode in ("ATTRIBUTES", "TRIANGLES", "INDICES") and 0 < count * stride <= MOST_BYTES
    right = right and (0 < stride <= 256 and stride % 4 == 0 if wide else stride in (2, 4))
    right = right and (mode != "TRIANGLES" or count % 3 == 0) and (filter_name == "NONE" or (wide and stride in sides))
    if not right:
        got = ", ".join(map(excerpt, (count, stride, mode, filter_name)))
        raise MeshError(label, expected="count, byteStride, mode and filter that go together", got=got, cure=EXPORT)
    library = _library("meshoptimizer", label)
    try:
        if wide:
            rows = library.decode_vertex_buffer(count, stride, payload, dtype=np.dtype(f"V{stride}"))
            if decode:
                rows = getattr(library, decode)(rows, count, stride)
            return rows.tobytes()
        unpack = library.decode_index_buffer if mode == "TRIANGLES" else library.decode_index_sequence
        return unpack(count, stride, payload).tobytes()[: count * stride]
    except (ValueError, RuntimeError) as error:
        got = str(error)[:80]
        raise MeshError(label, expected="rows that can be unpacked", got=got, cure=EXPORT) from error
