"""A GLB file while it is written: arrays one after the other, the rest as JSON (glTF 2.0, section 12.1)."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from drape.files.looks import NO_LOOKS, Looks, Material, media_type

GENERATOR = "drape"
PIECE_BYTES = 256 * 1024
QUANTIZATION, TRANSFORM = "KHR_mesh_quantization", "KHR_texture_transform"
TEXTURES = {
    "base_colour": "baseColorTexture",
    "normal": "normalTexture",
    "metallic_roughness": "metallicRoughnessTexture",
}
_COMPONENTS = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
_SHAPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
VERTEX_BUFFER, INDEX_BUFFER = 34962, 34963
Channel = tuple[int, str, np.ndarray]  # A node's index, the path that is animated, and its values in each frame.


class GlbFile:
    """A GLB file that grows: arrays one after the other, and everything else in its JSON part ``json``.

    It keeps the arrays that it is given, which may not change any more, and never has the file in one piece.
    """

    def __init__(self, document: dict[str, Any] | None = None, binary: bytes = b"") -> None:
        """A file of nothing, or one that goes on from the ``document`` and the ``binary`` chunk of another."""
        self.json: dict[str, Any] = document or {
            "asset": {"version": "2.0", "generator": GENERATOR},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "meshes": [],
            "materials": [],
            "accessors": [],
            "bufferViews": [],
        }
        for key in ("nodes", "meshes", "materials", "accessors", "bufferViews"):
            self.json.setdefault(key, [])
        self._arrays: list[np.ndarray] = []
        self._size = 0  # The size [bytes] of the binary chunk so far.
        self._animation: dict[str, Any] | None = None
        # Keys are ids of pictures, which hold while the pictures are kept.
        self._textures: dict[int, tuple[bytes, int]] = {}
        if binary:
            self._append(np.frombuffer(binary, np.uint8))

    def add(self, key: str, value: dict[str, Any]) -> int:
        """Appends ``value`` to the list ``key`` of the JSON part. Returns its index there."""
        rows = self.json.setdefault(key, [])
        rows.append(value)
        return len(rows) - 1

    def array(
        self, array: np.ndarray, *, target: int | None = None, bounds: bool = False, normalized: bool = False
    ) -> int:
        """Adds ``array`` (N, ...) as an accessor. Returns the accessor's index. ``target`` is glTF's number of the kind
        of buffer. ``bounds`` writes the least and the largest values, which positions and times need. ``normalized``:
        the largest integer stands for one."""
        array = np.ascontiguousarray(array)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self._size, "byteLength": array.nbytes}
        if target is not None:
            view["target"] = target
        self._append(array)
        accessor: dict[str, Any] = {
            "bufferView": self.add("bufferViews", view),
            "componentType": _COMPONENTS[array.dtype.name],
            "count": len(array),
            "type": _SHAPES[array.shape[1:]],
        }
        if normalized:
            accessor["normalized"] = True
        if bounds:
            rows = array.reshape(len(array), -1)
            accessor["min"], accessor["max"] = rows.min(axis=0).tolist(), rows.max(axis=0).tolist()
        return self.add("accessors", accessor)

    def _append(self, array: np.ndarray) -> None:
        self._arrays.append(array)
        self._size += _padded(array.nbytes)

    def quantised(self) -> None:
        """Declares in the file that vertices are quantised (KHR_mesh_quantization), and that readers must know this."""
        self.uses(QUANTIZATION, "extensionsUsed", "extensionsRequired")

    def uses(self, extension: str, *lists: str) -> None:
        """Adds ``extension`` to ``lists`` of the JSON part, "extensionsUsed" by default."""
        for one in lists or ("extensionsUsed",):
            used = self.json.setdefault(one, [])
            if extension not in used:
                used.append(extension)

    def quantised_rows(self, arrays: np.ndarray, *, bounds: bool = False) -> list[int]:
        """Adds ``arrays`` (N, V, 3), int8 or int16, as N normalized accessors in one buffer view, whose rows have four
        numbers. Returns the indices of the accessors. ``bounds`` writes their least and largest values."""
        size = arrays.dtype.itemsize
        rows = np.zeros((*arrays.shape[:2], 4), arrays.dtype)
        rows[..., :3] = arrays
        view = {"buffer": 0, "byteOffset": self._size, "byteLength": rows.nbytes, "byteStride": 4 * size}
        index = self.add("bufferViews", view | {"target": VERTEX_BUFFER})
        self._append(rows)
        accessors = []
        for i, array in enumerate(arrays):
            accessor: dict[str, Any] = {
                "bufferView": index,
                "byteOffset": i * 4 * size * len(array),
                "componentType": _COMPONENTS[arrays.dtype.name],
                "normalized": True,
                "count": len(array),
                "type": "VEC3",
            }
            if bounds:
                accessor["min"], accessor["max"] = array.min(axis=0).tolist(), array.max(axis=0).tolist()
            accessors.append(self.add("accessors", accessor))
        return accessors

    def animate(self, frames: int, fps: float, channels: Sequence[Channel]) -> None:
        """Adds ``channels`` to the one animation that we write. A channel is a node's index, the path that is animated,
        and its values (``frames``, ...), at ``fps`` frames a second."""
        times = self.array((np.arange(frames) / fps).astype(np.float32), bounds=True)
        if self._animation is None:
            self._animation = {"name": "drape", "channels": [], "samplers": []}
            self.add("animations", self._animation)
        animation = self._animation
        for node, path, values in channels:
            sampler = {"input": times, "output": self.array(values), "interpolation": "LINEAR"}
            animation["channels"].append(
                {"sampler": len(animation["samplers"]), "target": {"node": node, "path": path}}
            )
            animation["samplers"].append(sampler)

    def node(self, value: dict[str, Any]) -> int:
        """Adds the node ``value`` to the top of the scene. Returns its index."""
        index = self.add("nodes", value)
        self.json["scenes"][self.json.get("scene", 0)].setdefault("nodes", []).append(index)
        return index

    def place(self, name: str, point: np.ndarray) -> None:
        """Adds a node ``name`` at ``point`` [m] (3,), which JSON holds in float64, and moves what is at the top of the
        scene below it. Skinned meshes stay at the top: they go where their joints are."""
        top = self.json["scenes"][0]["nodes"]
        skinned = [index for index in top if "skin" in self.json["nodes"][index]]
        children = [index for index in top if index not in skinned]
        placed = self.add("nodes", {"name": name, "translation": point.tolist(), "children": children})
        self.json["scenes"][0]["nodes"] = [placed, *skinned]

    def material(
        self,
        name: str,
        colour: tuple[float, float, float, float],
        looks: Looks = NO_LOOKS,
        index: int = 0,
        *,
        with_pictures: bool = True,
    ) -> int:
        """Adds a material and returns its index: material ``index`` of ``looks``, or a plain one of ``colour`` (linear
        red, green, blue and opacity) where that has no look.

        Cloth is drawn from both sides, whatever its file says. ``with_pictures``: the mesh has texture coordinates.
        """
        look = looks.material(index)
        if look is None:
            look = Material(colour)
        surface: dict[str, Any] = {
            "baseColorFactor": list(look.base_colour),
            "metallicFactor": look.metallic,
            "roughnessFactor": look.roughness,
        }
        document: dict[str, Any] = {"name": name, "doubleSided": True, "pbrMetallicRoughness": surface}
        if look.alpha_mode != "OPAQUE":
            document["alphaMode"] = look.alpha_mode
        if look.alpha_mode == "MASK":
            document["alphaCutoff"] = look.alpha_cutoff
        placed = {"offset": list(look.offset), "rotation": look.rotation, "scale": list(look.scale)}
        for slot, number in look.pictures.items() if with_pictures else ():
            texture: dict[str, Any] = {"index": self._texture(looks.pictures[number])}
            if placed != {"offset": [0.0, 0.0], "rotation": 0.0, "scale": [1.0, 1.0]}:
                self.uses(TRANSFORM)
                texture["extensions"] = {TRANSFORM: placed}
            (document if slot == "normal" else surface)[TEXTURES[slot]] = texture
        return self.add("materials", document)

    def _texture(self, picture: bytes) -> int:
        """The texture of a ``picture``, which is in the file once."""
        if id(picture) not in self._textures:
            view = {"buffer": 0, "byteOffset": self._size, "byteLength": len(picture)}
            self._append(np.frombuffer(picture, np.uint8))
            image = {"bufferView": self.add("bufferViews", view), "mimeType": media_type(picture)}
            texture = self.add("textures", {"source": self.add("images", image)})
            self._textures[id(picture)] = picture, texture
        return self._textures[id(picture)][1]

    def head(self) -> bytes:
        """Returns the bytes of the file before the arrays: the header, the JSON chunk, and the head of the binary
        chunk."""
        self.json["buffers"] = [{"byteLength": self._size}]
        text = json.dumps(self.json, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + self._size
        head = struct.pack("<4sII", b"glTF", 2, size) + struct.pack("<I4s", len(text), b"JSON")
        return b"".join([head, text, struct.pack("<I4s", self._size, b"BIN\0")])

    def pieces(self) -> Iterator[bytes]:
        """Yields the arrays' bytes, the content of the binary chunk, in pieces of at most ``PIECE_BYTES``."""
        for array in self._arrays:
            flat = array.reshape(-1).view(np.uint8)
            for start in range(0, len(flat), PIECE_BYTES):
                yield flat[start : start + PIECE_BYTES].tobytes()
            if padding := _padded(array.nbytes) - array.nbytes:
                yield b"\0" * padding

    @property
    def binary_bytes(self) -> int:
        """The size [bytes] of the content of the binary chunk."""
        return self._size

    def to_bytes(self) -> bytes:
        """Returns the whole file."""
        return b"".join([self.head(), *self.pieces()])


def _padded(size: int) -> int:
    """``size`` up to the next multiple of 4, where the next array begins."""
    return size + -size % 4
