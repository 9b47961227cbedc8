"""The layout of a garment, sent once: with it a client makes vertices of jets.

A chart (patch k, weight w, parameters u, v) carries a vertex with the rest place x to
``centre_k + R_k (R0_k^T (x - c0_k) + s_k jet_k(u, v))``, with R0, c0 and s the patch's frame and scale at rest, R,
centre and jet those of a ``JetFrame``; the draped vertex is the weighted mean over its charts. Rest places do not
change with the body's shape: the frame does. Points between the vertices move in the same way, so a client may draw a
finer mesh than the service has.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drape.arrays import check_shape
from drape.errors import InputError
from drape.geometry import jets, meshes
from drape.wire import messages as wire
from drape.wire.jets import JetFrame

PATCH_NUMBERS = 13  # rotation, centre, scale
CHART_NUMBERS = 3  # weight, u, v
ROWS_AT_ONCE = 16384  # vertices that are evaluated together, in some 40 MB
_HEADER = wire.record(wire.LAYOUTS["LAYOUT"])
HEADER_BYTES = _HEADER.size


@dataclass(frozen=True, eq=False)
class JetLayout:
    """Constants of a garment of K patches and V vertices with C charts each.

    Patches at rest: ``rotation`` (K, 3, 3), ``centre`` (K, 3) [m], ``scale`` (K,) [m]. ``rest`` (V, 3) [m] are the
    vertices at rest. Of its charts ``chart_patch`` (V, C) are the patches, ``chart_weight`` (V, C) the weights, rows
    summing to one, and ``chart_uv`` (V, C, 2) the parameters [patch scales].
    """

    rotation: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    rest: np.ndarray
    chart_patch: np.ndarray
    chart_weight: np.ndarray
    chart_uv: np.ndarray

    @property
    def patch_count(self) -> int:
        return len(self.scale)

    def vertices(self, frame: JetFrame) -> np.ndarray:
        """Returns the vertices [m] (V, 3) of ``frame`` in the world, float64.

        Refuses (``InputError``) a frame of another number of patches.
        """
        return self.positions(frame) + frame.root

    def positions(self, frame: JetFrame) -> np.ndarray:
        """Returns the vertices [m] (V, 3) of ``frame`` relative to its root, float32; refuses what ``vertices``
        does."""
        if len(frame.jet) != self.patch_count:
            raise InputError(
                "patches",
                expected=f"{self.patch_count}, as in the layout",
                got=str(len(frame.jet)),
                cure="Fetch the layout of the garment that the frame shows; part an outfit's frame into layers first.",
            )
        rotation = np.asarray(frame.rotation, dtype=np.float32)
        surface = np.reshape(frame.jet, (-1, 3, jets.HEIGHT_COUNT)) * self.scale[:, None, None]
        posed = np.concatenate([rotation, rotation @ surface.astype(np.float32), frame.centre[..., None]], axis=2)
        parts = []
        for start in range(0, len(self.rest), ROWS_AT_ONCE):
            part = slice(start, start + ROWS_AT_ONCE)
            by_chart = posed[self.chart_patch[part]] @ self._columns[part][..., None]  # (n, C, 3, 1)
            parts.append(by_chart[..., 0].sum(axis=1))
        return np.concatenate(parts)

    def on(self, corners: np.ndarray, shares: np.ndarray) -> JetLayout:
        """Returns the layout of P points on triangles: ``corners`` (P, 3) are the indices of a triangle's vertices,
        ``shares`` (P, 3) the barycentric coordinates of the point.

        A point has the charts of its corners, weighted by its shares, each continued along the triangle to the point.
        So a point in a corner is that vertex, and triangles that meet at an edge agree there. Refuses (``InputError``)
        indices that are no vertices.
        """
        check_shape("corners", corners, (None, 3))
        check_shape("shares", shares, (len(corners), 3))
        if corners.size and (corners.min() < 0 or corners.max() >= len(self.rest)):
            raise InputError(
                "corners",
                expected=f"vertices in [0, {len(self.rest)})",
                got=f"[{corners.min()}, {corners.max()}]",
                cure="Use the faces of this garment's own mesh.",
            )
        rest = np.einsum("pc,pca->pa", shares, self.rest[corners].astype(np.float64))
        patch = self.chart_patch[corners]  # (P, 3, C)
        way = rest[:, None] - self.rest[corners]
        along = np.einsum("pckab,pca->pckb", self.rotation[patch][..., :2], way)
        uv = self.chart_uv[corners] + along / self.scale[patch][..., None]
        weight = shares[..., None] * self.chart_weight[corners]
        count = len(corners)
        charts = _merged(patch.reshape(count, -1), weight.reshape(count, -1), uv.reshape(count, -1, 2))
        return JetLayout(self.rotation, self.centre, self.scale, rest.astype(np.float32), *charts)

    def subdivided(self, faces: np.ndarray) -> tuple[JetLayout, np.ndarray]:
        """Returns the layout with one more vertex on every edge of ``faces`` (F, 3), and the faces (4 F, 3) of that
        mesh.

        The first vertices are those of this layout, in their order.
        """
        _, finer, parents = meshes.subdivide(self.rest, faces)
        corners = np.column_stack([parents, parents[:, 0]])
        return self.on(corners, np.tile([0.5, 0.5, 0.0], (len(corners), 1))), finer

    @cached_property
    def _columns(self) -> np.ndarray:
        """Columns (V, C, 19) that multiply [rotation, jet, centre] of a chart's patch, times the chart's weight."""
        offset = self.rest[:, None].astype(np.float64) - self.centre[self.chart_patch]
        local = np.einsum("vkba,vkb->vka", self.rotation[self.chart_patch].astype(np.float64), offset)
        basis = jets.basis(self.chart_uv.astype(np.float64), jets.HEIGHT_ORDER)
        column = np.concatenate([local, basis, np.ones((*basis.shape[:2], 1))], axis=-1)
        return (self.chart_weight[..., None] * column).astype(np.float32)


def _merged(patch: np.ndarray, weight: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Charts (P, C') of rows (P, C) in which a patch may come several times: each patch once, at its mean parameters,
    in as few columns as possible."""
    order = np.argsort(patch, axis=1, kind="stable")
    patch = np.take_along_axis(patch, order, axis=1)
    weight = np.take_along_axis(weight, order, axis=1).astype(np.float64)
    uv = np.take_along_axis(uv, order[..., None], axis=1).astype(np.float64) * weight[..., None]
    for column in range(1, patch.shape[1]):  # the sum of a patch moves on to its next entry
        same = patch[:, column] == patch[:, column - 1]
        for values in (weight, uv):
            values[same, column] += values[same, column - 1]
            values[same, column - 1] = 0.0
    order = np.argsort(-weight, axis=1, kind="stable")
    order = order[:, : max(1, int((weight > 0.0).sum(axis=1).max(initial=0)))]
    patch, weight = np.take_along_axis(patch, order, axis=1), np.take_along_axis(weight, order, axis=1)
    uv = np.take_along_axis(uv, order[..., None], axis=1) / np.where(weight > 0.0, weight, 1.0)[..., None]
    return patch, weight.astype(np.float32), uv.astype(np.float32)


def pack_layout(layout: JetLayout) -> bytes:
    """Returns the LAYOUT message: header, then float32 rows of patches, rest vertices and charts, then the charts'
    patches, uint16."""
    vertices, charts = layout.chart_patch.shape
    header = _HEADER.pack(
        wire.MAGIC, wire.WIRE_VERSION, wire.LAYOUT, 0, 0, layout.patch_count, vertices, charts
    )  # fmt: skip
    patches = [layout.rotation.reshape(-1, 9), layout.centre, layout.scale[:, None]]
    numbers = [
        np.concatenate(patches, axis=1),
        layout.rest,
        np.concatenate([layout.chart_weight[..., None], layout.chart_uv], axis=-1),
    ]
    payload = b"".join(np.ascontiguousarray(part, dtype="<f4").tobytes() for part in numbers)
    payload += layout.chart_patch.astype("<u2").tobytes()
    return header + payload + b"\0" * (-len(payload) % 4)


def unpack_layout(message: bytes) -> JetLayout:
    """Returns the layout in the LAYOUT ``message``.

    Refuses (``InputError``) another size, version or kind, and charts of patches that it does not have.
    """
    wire.check_prefix("layout message", message, wire.LAYOUT, least=HEADER_BYTES)
    *_, patches, vertices, charts = _HEADER.unpack_from(message)
    entries = vertices * charts
    floats = PATCH_NUMBERS * patches + 3 * vertices + CHART_NUMBERS * entries
    size = HEADER_BYTES + 4 * floats + 2 * entries
    size += -size % 4
    what = f"for {patches} patches and {vertices} vertices of {charts} charts"
    wire.check_length("layout message", message, size, what)
    numbers = np.frombuffer(message, "<f4", floats, HEADER_BYTES)
    ends = np.cumsum([PATCH_NUMBERS * patches, 3 * vertices])
    patch, rest, chart = np.split(numbers, ends)
    patch, chart = patch.reshape(patches, PATCH_NUMBERS), chart.reshape(vertices, charts, CHART_NUMBERS)
    chart_patch = np.frombuffer(message, "<u2", entries, HEADER_BYTES + 4 * floats).reshape(vertices, charts)
    if entries and chart_patch.max() >= patches:
        raise InputError(
            "layout message",
            expected=f"patches in [0, {patches})",
            got=str(chart_patch.max()),
            cure="Fetch the layout again.",
        )
    return JetLayout(
        rotation=patch[:, :9].reshape(-1, 3, 3),
        centre=patch[:, 9:12],
        scale=patch[:, 12],
        rest=rest.reshape(-1, 3),
        chart_patch=chart_patch.astype(np.int64),
        chart_weight=chart[..., 0],
        chart_uv=chart[..., 1:],
    )
