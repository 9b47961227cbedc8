"""A glTF file as it is read: its JSON, and accessors as arrays (glTF 2.0, sections 3.6 and 12).

Nothing in a stranger's file is trusted: its JSON is checked (``drape.files.gltf_json``), every offset, count and index
is compared with what is there before an array is made, and what is made is bounded.
"""

from __future__ import annotations

import base64
import math
import struct
from collections.abc import Callable
from typing import Any
from urllib.parse import unquote

import numpy as np

from drape.errors import MeshError
from drape.files.gltf_compressed import DRACO, MESHOPT, draco_parts, meshopt_view
from drape.files.gltf_json import EXPORT, SHRINK, Document, document_of, excerpt

FILE_BYTES = 96 * 2**20
JSON_BYTES = 16 * 2**20
MOST_NUMBERS = 16_000_000  # The most numbers of an accessor: a million vertices have three million.
COMPONENTS = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_HEADER, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")


class GltfFile:
    """The checked ``document`` of a GLB or glTF file, and its arrays. Raises ``MeshError`` for bytes that are neither.

    ``beside`` returns the bytes of a file that a glTF names, or None. ``label`` names the file in refusals.
    """

    def __init__(
        self, payload: bytes, *, label: str = "avatar", beside: Callable[[str], bytes | None] = lambda name: None
    ) -> None:
        self.label, self._beside = label, beside
        if payload[:64].lstrip()[:1] == b"{" and len(payload) <= FILE_BYTES:
            self.document, self._binary = document_of(payload, label), b""
        else:
            self.document, self._binary = _chunks(payload, label)
        self._buffers: dict[int, bytes] = {}
        self._views: dict[int, bytes] = {}
        self._unpacked: dict[int, np.ndarray] = {}
        self._draco = {
            accessor: primitive
            for mesh in self.document.meshes
            for primitive in mesh.primitives
            if DRACO in primitive.extensions
            for accessor in (primitive.indices, *primitive.attributes.values())
        }

    def item(self, key: str, index: Any, said: str = "") -> Any:
        """Returns entry ``index`` of the document's list ``key``. Raises ``MeshError`` for an index that the list does
        not have; it names the field ``said``, where the index stood."""
        rows = getattr(self.document, key)
        if type(index) is not int or not 0 <= index < len(rows):
            raise self._fault(said or key, f"an index of {key} below {len(rows)}", excerpt(index))
        return rows[index]

    def count(self, index: Any) -> int:
        """Returns how many rows accessor ``index`` says that it has; 0 where that is no number, which ``array``
        refuses."""
        said = self.item("accessors", index, "primitives").get("count")
        return min(said, 10**9) if type(said) is int else 0

    def array(self, index: Any) -> np.ndarray:
        """Returns accessor ``index`` as (N, width), in the type that the file has, or float64 where its numbers are
        normalised. Raises ``MeshError`` for one that is damaged or too large."""
        accessor, count = self.item("accessors", index), self.count(index)
        kind, width = _known(COMPONENTS, accessor.get("componentType")), _known(WIDTHS, accessor.get("type"))
        if kind is None or width is None or not 0 < count * width <= MOST_NUMBERS:
            got = ", ".join(excerpt(accessor.get(key)) for key in ("componentType", "type", "count"))
            raise self._fault(f"accessors[{index}]", f"numbers of a known type, at most {MOST_NUMBERS:,}", got)
        if index in self._draco:
            values = self._from_draco(index, count, width, kind)
        elif "bufferView" in accessor:
            values = self._rows(accessor["bufferView"], accessor.get("byteOffset", 0), count, width, kind)
        else:
            values = np.zeros((count, width), kind)
        if "sparse" in accessor:
            values = self._with_sparse(values, accessor["sparse"], kind)
        if accessor.get("normalized") and kind is not np.float32:
            return np.maximum(values.astype(np.float64) / np.iinfo(kind).max, -1.0)
        if kind is np.float32 and not np.isfinite(values).all():
            raise self._fault(f"accessors[{index}]", "finite numbers", "NaN or infinity")
        return values

    def _from_draco(self, index: Any, count: int, width: int, kind: Any) -> np.ndarray:
        """Accessor ``index`` of a primitive that Draco packed."""
        if index not in self._unpacked:
            primitive = self._draco[index]
            entry = primitive.extensions[DRACO]
            view = entry.get("bufferView") if isinstance(entry, dict) else None
            self._unpacked |= draco_parts(self.view(view, "Draco's bufferView"), primitive, f"{self.label}: Draco")
        unpacked = self._unpacked.get(index)
        if unpacked is None or unpacked.shape != (count, width):
            got = "nothing" if unpacked is None else f"{unpacked.shape}"
            raise self._fault(f"accessors[{index}]", f"{count} rows of {width} from Draco", got)
        return unpacked.astype(kind)

    def picture(self, index: Any) -> bytes | None:
        """Returns the bytes of image ``index`` as they came; None if the image has none anywhere."""
        held = self.item("images", index, "textures.source")
        return self.view(held["bufferView"], "images") if "bufferView" in held else self._named(held.get("uri"))

    def view(self, index: Any, said: str) -> bytes:
        """Returns the bytes of buffer view ``index``, unpacked if they are packed. Raises ``MeshError`` for a damaged
        view, and for an index that does not exist; it names the field ``said``, where the index stood."""
        held = self.item("buffer_views", index, said)
        if index not in self._views:
            extensions = held.get("extensions")
            packed = extensions.get(MESHOPT) if isinstance(extensions, dict) else None
            entry = held if packed is None else packed
            if not isinstance(entry, dict):
                raise self._fault(f"bufferViews[{index}]", "an object", excerpt(entry))
            start, size, buffer = (entry.get(key, 0) for key in ("byteOffset", "byteLength", "buffer"))
            if not all(type(one) is int and one >= 0 for one in (start, size, buffer)):
                raise self._fault(f"bufferViews[{index}]", "whole numbers", ", ".join(map(excerpt, (start, size))))
            content = self._buffer(buffer)
            if start + size > len(content):
                raise self._fault(f"bufferViews[{index}]", f"at most {len(content)} bytes", f"{start + size}")
            rows = content[start : start + size]
            label = f"{self.label}: bufferViews[{index}]"
            self._views[index] = rows if packed is None else meshopt_view(rows, packed, label)
        return self._views[index]

    def _buffer(self, index: int) -> bytes:
        """The bytes of buffer ``index``: the file's own, or those that its address names."""
        if index not in self._buffers:
            uri = self.item("buffers", index).get("uri")
            content = self._binary if uri is None and index == 0 else self._named(uri)
            if content is None:
                cure = "Send it in the same zip, or export as one GLB file."
                raise self._fault(f"buffers[{index}]", "bytes in the file or beside it", excerpt(uri), cure)
            self._buffers[index] = content
        return self._buffers[index]

    def _named(self, uri: Any) -> bytes | None:
        """What an address names: data, or a file beside; None where it is neither."""
        if not isinstance(uri, str):
            return None
        if not uri.startswith("data:"):
            return self._beside(unquote(uri))
        try:
            return base64.b64decode(uri.partition(",")[2], validate=True)
        except ValueError:
            return None

    def _with_sparse(self, array: np.ndarray, sparse: Any, kind: Any) -> np.ndarray:
        """``array`` with the values that the accessor's ``sparse`` part puts in the place of others."""
        try:
            count, where, what = sparse["count"], sparse["indices"], sparse["values"]
            index_kind = _known(COMPONENTS, where["componentType"])
            views = where["bufferView"], what["bufferView"]
        except (KeyError, TypeError) as error:
            raise self._fault("accessor.sparse", "count, indices and values", str(error)[:40]) from error
        if not isinstance(count, int) or not 0 < count <= len(array) or index_kind in (None, np.float32):
            raise self._fault("accessor.sparse", f"at most {len(array)} whole indices", excerpt(count))
        rows = self._rows(views[0], where.get("byteOffset", 0), count, 1, index_kind)[:, 0].astype(np.int64)
        if rows.min() < 0 or rows.max() >= len(array):
            raise self._fault("accessor.sparse", f"indices below {len(array)}", str(rows.max()))
        found = array.copy()
        found[rows] = self._rows(views[1], what.get("byteOffset", 0), count, array.shape[1], kind)
        return found

    def _rows(self, view: Any, offset: Any, count: int, width: int, kind: Any) -> np.ndarray:
        """``count`` rows of ``width`` numbers in buffer view ``view``, from ``offset`` bytes on."""
        held = self.item("buffer_views", view, "accessor.bufferView")
        content, stride = self.view(view, "accessor.bufferView"), held.get("byteStride")
        row = width * np.dtype(kind).itemsize
        stride = row if stride is None else stride
        numbers = (stride, offset, count)
        if not all(type(one) is int and one >= 0 for one in numbers):
            raise self._fault(f"bufferViews[{view}]", "whole numbers", ", ".join(map(excerpt, numbers)))
        if stride < row or offset + (count - 1) * stride + row > len(content):
            got = f"{len(content)} bytes of {stride}"
            raise self._fault(f"bufferViews[{view}]", f"{count} rows of {row} bytes", got)
        return np.ndarray((count, width), kind, content, offset, (stride, np.dtype(kind).itemsize)).copy()

    def _fault(self, name: str, expected: str, got: str, cure: str = EXPORT) -> MeshError:
        return MeshError(f"{self.label}: {name}", expected=expected, got=got, cure=cure)


def _known(table: dict[Any, Any], key: Any) -> Any:
    """``table[key]``, None where it has no such key; a key of a stranger's file may be anything."""
    return table.get(key) if isinstance(key, (int, str)) else None


def _chunks(payload: bytes, label: str) -> tuple[Document, bytes]:
    """The checked JSON of a GLB file and its binary chunk."""
    cure = "Export it as GLB (glTF 2.0, binary) or VRM."
    if len(payload) > FILE_BYTES:
        got = f"{math.ceil(len(payload) / 2**20)} MB"
        raise MeshError(label, expected=f"at most {FILE_BYTES // 2**20} MB", got=got, cure="Shrink its textures.")
    if len(payload) < 20 or payload[:4] != b"glTF":
        raise MeshError(label, expected="a GLB or VRM file", got=f"{payload[:4]!r}", cure=cure)
    _, version, size = _HEADER.unpack_from(payload)
    if version != 2 or size > len(payload):
        got = f"version {version}, {len(payload):,} of {size:,} bytes"
        raise MeshError(label, expected="a whole GLB 2.0 file", got=got, cure=cure)
    length, kind = _CHUNK.unpack_from(payload, 12)
    if length > JSON_BYTES:
        expected, got = f"at most {JSON_BYTES // 2**20} MB", f"{math.ceil(length / 2**20)} MB"
        raise MeshError(f"{label}: JSON", expected=expected, got=got, cure=SHRINK)
    if kind != b"JSON" or length > len(payload) - 20:
        raise MeshError(label, expected="JSON first", got=f"{kind!r} of {length:,} bytes", cure=cure)
    document = document_of(payload[20 : 20 + length], label)
    start = 20 + length
    if start + 8 > len(payload):
        return document, b""
    length, kind = _CHUNK.unpack_from(payload, start)
    if kind != b"BIN\0" or start + 8 + length > len(payload):
        raise MeshError(label, expected="a whole binary chunk", got=f"{kind!r} of {length:,} bytes", cure=cure)
    return document, payload[start + 8 : start + 8 + length]
