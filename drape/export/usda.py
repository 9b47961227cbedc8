"""USD scenes as text (.usda): a mesh per garment whose points move, for every program that reads USD.

Metres, y up, a time code per frame. Points have five decimals: they are off by 0.005 mm at most. A scene whose
vertices count from a point of their own stands under an Xform at that point, in float64.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from drape.export.surface import MovingGarment

ROWS_A_PIECE = 1024  # The formatter holds the interpreter lock for half a millisecond.
POINT_BYTES = 28  # A point takes about so many bytes.


def usda_pieces(layers: Sequence[MovingGarment], fps: float, *, point: np.ndarray | None = None) -> Iterator[bytes]:
    """Yields the text of a USD scene of ``layers``, in UTF-8 and in pieces, at ``fps`` frames a second. Vertices count
    from ``point`` [m] (3,), the origin by default."""
    x, y, z = np.zeros(3).tolist() if point is None else point.tolist()
    yield (
        f'#usda 1.0\n(\n    defaultPrim = "clip"\n    endTimeCode = {len(layers[0].vertices) - 1}\n'
        f"    framesPerSecond = {fps!r}\n    metersPerUnit = 1\n    startTimeCode = 0\n"
        f'    timeCodesPerSecond = {fps!r}\n    upAxis = "Y"\n)\n\n'
        f'def Xform "clip"\n{{\n    double3 xformOp:translate = ({x!r}, {y!r}, {z!r})\n'
        '    uniform token[] xformOpOrder = ["xformOp:translate"]\n'
    ).encode()
    names = identifiers([layer.surface.name for layer in layers])
    for name, layer in zip(names, layers, strict=True):
        yield from _mesh(name, layer)
    yield b"}\n"


def _mesh(name: str, layer: MovingGarment) -> Iterator[bytes]:
    surface, frames = layer.surface, layer.vertices
    yield f'\n    def Mesh "{name}"\n    {{\n'.encode()
    yield b"        uniform bool doubleSided = 1\n        float3[] extent.timeSamples = {\n"
    for frame, vertices in enumerate(frames):
        yield f"            {frame}: [{_points(np.stack([vertices.min(axis=0), vertices.max(axis=0)]))}],\n".encode()
    yield b"        }\n        int[] faceVertexCounts = ["
    yield from _listed(np.full(len(surface.faces), 3))
    yield b"]\n        int[] faceVertexIndices = ["
    yield from _listed(surface.faces)
    yield b"]\n        point3f[] points.timeSamples = {\n"
    for frame, vertices in enumerate(frames):
        yield f"            {frame}: [".encode()
        yield from _listed_rows(vertices, "(%.5f, %.5f, %.5f)")
        yield b"],\n"
    yield f"        }}\n        color3f[] primvars:displayColor = [{_points(np.array([layer.colour[:3]]))}]\n".encode()
    if surface.uv_faces.size:
        yield b"        texCoord2f[] primvars:st = ["
        yield from _listed_rows(surface.uv, "(%.6g, %.6g)")
        yield b'] (\n            interpolation = "faceVarying"\n        )\n        int[] primvars:st:indices = ['
        yield from _listed(surface.uv_faces)
        yield b"]\n"
    yield b'        uniform token subdivisionScheme = "none"\n'
    for number, part in enumerate(identifiers(surface.material_names)):
        yield f'\n        def GeomSubset "{part}"\n        {{\n'.encode()
        yield b'            uniform token elementType = "face"\n            uniform token familyName = "materialBind"\n'
        yield b"            int[] indices = ["
        yield from _listed(np.flatnonzero(surface.face_material == number))
        yield b"]\n        }\n"
    yield b"    }\n"


def _points(points: np.ndarray) -> str:
    return b"".join(_listed_rows(points, "(%.5f, %.5f, %.5f)")).decode()


def _listed_rows(rows: np.ndarray, form: str) -> Iterator[bytes]:
    """``rows`` (N, n), each as ``form`` writes it, with commas between."""
    for start in range(0, len(rows), ROWS_A_PIECE):
        part = rows[start : start + ROWS_A_PIECE]
        yield ((", " if start else "") + ", ".join([form] * len(part)) % tuple(part.ravel().tolist())).encode()


def _listed(numbers: np.ndarray) -> Iterator[bytes]:
    """Integers with commas between."""
    return _listed_rows(numbers.reshape(-1, 1), "%d")


def identifiers(names: Sequence[str]) -> list[str]:
    """Returns ``names`` as names of USD's prims, in their order: letters, digits and underscores of ASCII. Equal ones
    get numbers."""
    names_so_far: list[str] = []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name) or "_"
        plain = f"_{plain}" if plain[0].isdigit() else plain
        number, unique = 1, plain
        while unique in names_so_far:
            number += 1
            unique = f"{plain}_{number}"
        names_so_far.append(unique)
    return names_so_far
