"""The pictures of a fit report: target beside result, panels over base, what the target cannot tell, retargeting."""

from __future__ import annotations

import io
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from PIL import Image
from scipy.spatial import KDTree

from drape.garment.files.mesh import GarmentMesh
from drape.geometry import closest, meshes
from drape.geometry.raster import CLOTH, SKIN, Surface, render
from recovery.pattern import geometry
from recovery.pattern.sewing_pattern import Panel, Pattern
from recovery.pattern.symmetry import procrustes
from recovery.run.identify import CAP_M, Identifiability
from recovery.run.sew_anew import WornElsewhere

DPI = 100
# Under the cloth the body is drawn thinner by this: flat triangles cut into it between their corners.
THIN_M, THIN_REACH_M = 0.012, 0.05
TARGET_COLOUR = (0.62, 0.62, 0.66)
SPOT_COLOUR, SPOT_SHARE = (0.9, 0.1, 0.1), 0.04  # the mark of a fault, and its size over the scan's extent
SCALE_SHARE = 0.98  # share of the vertices that lie within the colour scale
EDGE_SHARE = 0.14  # share of a garment's extent that is left free round it
VIEWS = (("front", 0.0), ("side", 70.0), ("back", 180.0))


class MeshArrays(NamedTuple):
    """A mesh: ``vertices`` [m] (V, 3) and ``faces`` (F, 3)."""

    vertices: np.ndarray
    faces: np.ndarray


def target_and_result(target: MeshArrays, result: MeshArrays, skin: MeshArrays) -> bytes:
    """Returns a PNG with three views each of the target, of the result, and of the result coloured by its distance from
    the target.
    """
    distance = 1e3 * closest.closest_point(result.vertices, target.vertices, target.faces).distance
    scale = Normalize(0.0, max(1.0, float(np.quantile(distance, SCALE_SHARE))))
    colours = matplotlib.colormaps["turbo"](scale(distance[result.faces].mean(axis=1)))[:, :3]
    body = _body(skin, target.vertices)
    rows = {
        "target": [body, Surface(*target, TARGET_COLOUR)],
        "recovered": [body, Surface(*result, CLOTH)],
        "distance": [body, Surface(*result, colours)],
    }
    middle = 0.5 * (target.vertices.min(axis=0) + target.vertices.max(axis=0))
    extent = 1.25 * float(np.ptp(target.vertices, axis=0).max())
    figure = Figure(figsize=(3.0 * len(VIEWS) + 0.9, 8.4), dpi=DPI, layout="constrained")
    axes = figure.subplots(len(rows), len(VIEWS), squeeze=False)
    for row, (name, surfaces) in zip(axes, rows.items(), strict=True):
        for axis, (view, azimuth) in zip(row, VIEWS, strict=True):
            axis.imshow(render(surfaces, size=(360, 400), azimuth_deg=azimuth, centre=middle, extent_m=extent))
            axis.set_axis_off()
            axis.set_title(f"{name}, {view}", fontsize=9)
    bar = ScalarMappable(scale, "turbo")
    figure.colorbar(bar, ax=axes[-1], label="distance from the target [mm]", shrink=0.9, extend="max")
    return png(figure)


def target_above_result(target: MeshArrays, result: MeshArrays, skin: MeshArrays, size: tuple[int, int]) -> bytes:
    """Returns a PNG of the target and, below it, of the result, both from the front and each of ``size`` (height,
    width) in pixels.
    """
    body, middle = _body(skin, target.vertices), 0.5 * (target.vertices.min(axis=0) + target.vertices.max(axis=0))
    extent = float(np.ptp(target.vertices, axis=0)[:2].max()) * (1.0 + EDGE_SHARE)
    rows = [
        render([body, Surface(*mesh, colour)], size=size, centre=middle, extent_m=extent)
        for mesh, colour in ((target, TARGET_COLOUR), (result, CLOTH))
    ]
    packed = io.BytesIO()
    Image.fromarray(np.rint(255.0 * np.concatenate(rows)).astype(np.uint8)).save(packed, "png", optimize=True)
    return packed.getvalue()


def fault_picture(mesh: GarmentMesh, points: np.ndarray) -> bytes:
    """Returns a PNG with three views of a scan; the places ``points`` (P, 3) of its fault, in the scan's own unit, are
    red.
    """
    size = float(np.ptp(mesh.vertices, axis=0).max())
    vertices = (mesh.vertices - mesh.vertices.min(axis=0)) / size
    middles = vertices[mesh.faces].mean(axis=1)
    spots = (points - mesh.vertices.min(axis=0)) / size
    far = np.asarray(KDTree(spots).query(middles)[0])
    colours = np.where((far < SPOT_SHARE)[:, None], SPOT_COLOUR, TARGET_COLOUR)
    figure = Figure(figsize=(3.0 * len(VIEWS), 3.6), dpi=DPI, layout="constrained")
    for axis, (view, azimuth) in zip(figure.subplots(1, len(VIEWS)), VIEWS, strict=True):
        axis.imshow(render([Surface(vertices, mesh.faces, colours)], size=(360, 300), azimuth_deg=azimuth))
        axis.set_axis_off()
        axis.set_title(view, fontsize=9)
    return png(figure)


def panels_over_base(base: Pattern, pattern: Pattern) -> bytes:
    """Returns a PNG of every panel of the recovered ``pattern`` (filled) over the same panel of the ``base`` (dashed),
    which is turned and shifted to where it fits best. All are drawn at one scale."""
    figure, axes = _panel_axes(pattern)
    for axis, old, new in zip(axes, base.panels, pattern.panels, strict=False):
        line, was = geometry.outline(new), _laid(old, new)
        axis.fill(*line.T, facecolor=(*CLOTH, 0.25), edgecolor=CLOTH, linewidth=1.6, label="recovered")
        axis.fill(*was.T, fill=False, linestyle="--", edgecolor="0.25", linewidth=1.0, label="base")
        axis.set_title(new.name.replace("_", " "), fontsize=9)
    _ruler(axes[0])
    axes[0].legend(fontsize=7, loc="lower right")
    return png(figure)


def undetermined_corners(limits: Identifiability, pattern: Pattern) -> bytes:
    """Returns a PNG of what the target tells about ``pattern``: a disc at each corner as large as the corner is
    undetermined, and the spectra of how far the cloth moves and what the target shows."""
    figure, axes = _panel_axes(pattern, more=1)
    first = 0
    for axis, panel in zip(axes, pattern.panels, strict=False):
        own = limits.slack_m[first : first + len(panel.edges)]
        corners = panel.vertices[[edge.start for edge in panel.edges]]
        first += len(panel.edges)
        axis.fill(*geometry.outline(panel).T, facecolor="0.94", edgecolor="0.3", linewidth=1.0)
        colours = matplotlib.colormaps["RdYlGn_r"](np.clip(own / 0.02, 0.0, 1.0))
        turn = np.linspace(0.0, 2.0 * np.pi, 40)
        for corner, radius, colour in zip(corners, own, colours, strict=True):
            ring = corner + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
            axis.fill(*ring.T, facecolor=(*colour[:3], 0.55), edgecolor=colour, linewidth=0.8)
            text = f">{100 * CAP_M:.0f} cm" if radius >= CAP_M else f"{1e3 * radius:.0f}"
            axis.text(float(corner[0]), float(corner[1]), text, fontsize=6.5, ha="center", va="center")
        axis.set_title(panel.name.replace("_", " "), fontsize=9)
    _ruler(axes[0])
    spectrum = axes[len(pattern.panels)]
    spectrum.semilogy(1.0 + np.arange(len(limits.cloth)), limits.cloth, ".-", color="0.5", label="cloth moves")
    spectrum.semilogy(1.0 + np.arange(len(limits.seen)), limits.seen[::-1], ".-", color="C3", label="target shows")
    spectrum.set_title("mm per mm of pattern", fontsize=9)
    spectrum.tick_params(labelsize=7)
    spectrum.legend(fontsize=7)
    return png(figure)


def search_history(history: np.ndarray) -> bytes:
    """Returns a PNG with two curves over the steps of a search, the distance [mm] of the surfaces and that of the
    contours. ``history`` (I + 1, 4) is that of ``Fitted``."""
    figure = Figure(figsize=(6.0, 2.6), dpi=DPI, layout="constrained")
    axis = figure.subplots()
    for column, name in ((1, "surfaces"), (2, "openings")):
        axis.semilogy(1e3 * np.sqrt(0.5 * np.maximum(history[:, column], 1e-18)), marker=".", label=name)
    axis.set_xlabel("step")
    axis.set_ylabel("distance [mm]")
    axis.legend(fontsize=8)
    axis.grid(alpha=0.3)
    return png(figure)


def worn_elsewhere(places: list[WornElsewhere]) -> bytes:
    """Returns a PNG of the garment on every body and in every pose that it was taken to, front above back."""
    figure = Figure(figsize=(2.8 * len(places), 7.2), dpi=DPI, layout="constrained")
    axes = figure.subplots(2, len(places), squeeze=False)
    for column, worn in enumerate(places):
        surfaces = [_body(MeshArrays(worn.skin, worn.skin_faces), worn.nodes)]
        if len(worn.faces):
            surfaces.append(Surface(worn.nodes, worn.faces, CLOTH))
        for row, azimuth in enumerate((0.0, 160.0)):
            axis = axes[row][column]
            axis.imshow(render(surfaces, size=(420, 340), azimuth_deg=azimuth))
            axis.set_axis_off()
        axes[0][column].set_title(worn.what + ("" if len(worn.faces) else ": refused"), fontsize=9)
    return png(figure)


def png(figure: Figure) -> bytes:
    """Returns ``figure`` as a PNG with a palette."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    picture = Image.open(buffer).convert("RGB")
    packed = io.BytesIO()
    picture.quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(packed, "png", optimize=True)
    return packed.getvalue()


def _body(skin: MeshArrays, cloth: np.ndarray) -> Surface:
    if not len(cloth):
        return Surface(*skin, SKIN)
    far = np.asarray(KDTree(cloth).query(skin.vertices)[0])
    inward = THIN_M * np.exp(-((far / THIN_REACH_M) ** 2))[:, None]
    return Surface(skin.vertices - inward * meshes.vertex_normals(skin.vertices, skin.faces), skin.faces, SKIN)


def _panel_axes(pattern: Pattern, *, more: int = 0) -> tuple[Figure, list[Axes]]:
    """A grid of axes at one scale, one for every panel, and ``more`` plain ones behind them."""
    count = len(pattern.panels) + more
    columns = min(4, count)
    rows = -(-count // columns)
    figure = Figure(figsize=(2.7 * columns, 3.0 * rows), dpi=DPI, layout="constrained")
    axes = list(figure.subplots(rows, columns, squeeze=False).reshape(-1))
    half = 0.56 * max(float(np.ptp(geometry.outline(panel), axis=0).max()) for panel in pattern.panels)
    for number, axis in enumerate(axes):
        if number < len(pattern.panels):
            line = geometry.outline(pattern.panels[number])
            middle = 0.5 * (line.min(axis=0) + line.max(axis=0))
            axis.set_xlim(middle[0] - half, middle[0] + half)
            axis.set_ylim(middle[1] - half, middle[1] + half)
            axis.set_aspect("equal")
        if number < len(pattern.panels) or number >= count:
            axis.set_axis_off()
    return figure, axes


def _ruler(axis: Axes) -> None:
    (left, _), (low, _) = axis.get_xlim(), axis.get_ylim()
    axis.plot([left, left + 0.1], [low, low], color="black", linewidth=2.0)
    axis.text(left, low, "10 cm", fontsize=7, va="bottom")


def _laid(panel: Panel, on: Panel) -> np.ndarray:
    """The outline (N, 2) of ``panel`` moved rigidly to where its corners fit those of ``on`` best."""
    if len(panel.vertices) != len(on.vertices):
        return geometry.outline(panel)
    matrix, _ = procrustes(panel.vertices, on.vertices, reflect=False)
    return (geometry.outline(panel) - panel.vertices.mean(axis=0)) @ matrix + on.vertices.mean(axis=0)
