"""A picture of a pattern: the panels with their mesh, every stitch in one colour on both sides, and the placement."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from recovery.pattern import geometry
from recovery.pattern.pattern_mesh import PatternMesh
from recovery.pattern.pieces import make_sheet
from recovery.pattern.sewing_pattern import Pattern

INCH_PER_M = 5.0
DPI = 100


def draw_pattern(mesh: PatternMesh, path: Path) -> None:
    """Writes a PNG to ``path``: the flat panels with numbered stitches, and the panels as placed, from an angle."""
    pattern = mesh.pattern
    sheet = make_sheet(pattern, allowance_m=0.0)
    width, height = INCH_PER_M * sheet.width_m, INCH_PER_M * sheet.height_m
    figure = Figure(figsize=(width + 5.0, max(height, 4.0)), dpi=DPI, layout="constrained")
    flat, placed = figure.subplots(1, 2, width_ratios=[width, 5.0])
    for number, (panel, offset) in enumerate(zip(pattern.panels, sheet.offsets, strict=True)):
        triangles = mesh.panel_faces[mesh.face_panel == number]
        points = mesh.rest + offset
        flat.triplot(points[:, 0], points[:, 1], triangles, color="0.8", linewidth=0.4)
        outline = geometry.outline(panel) + offset
        flat.fill(outline[:, 0], outline[:, 1], facecolor="none", edgecolor="0.2", linewidth=1.0)
        middle = sheet.pieces[number].grain.mean(axis=0) + offset
        flat.text(*middle, panel.name.replace("_", "\n"), ha="center", va="center", fontsize=8)
    _draw_stitches(flat, pattern, sheet.offsets)
    flat.set_aspect("equal")
    flat.set_axis_off()
    flat.set_title(f"{pattern.name}: {len(pattern.panels)} panels, {len(pattern.stitches)} stitches")
    _draw_placed(placed, mesh)
    figure.savefig(path)


def _colours(count: int) -> list[tuple[float, float, float, float]]:
    return [matplotlib.colormaps["hsv"](share) for share in np.linspace(0.0, 1.0, count, endpoint=False)]


def _draw_stitches(axes: Axes, pattern: Pattern, offsets: np.ndarray) -> None:
    number_of = {panel.name: number for number, panel in enumerate(pattern.panels)}
    for number, (stitch, colour) in enumerate(
        zip(pattern.stitches, _colours(len(pattern.stitches)), strict=True), start=1
    ):
        for ref in (stitch.first, stitch.second):
            panel = pattern.panel(ref.panel)
            points = geometry.flatten(panel, ref.edge, 1e-4) + offsets[number_of[ref.panel]]
            axes.plot(points[:, 0], points[:, 1], color=colour, linewidth=2.0)
            middle = geometry.edge_points(panel, ref.edge, np.array([0.5]))[0] + offsets[number_of[ref.panel]]
            axes.text(middle[0], middle[1], str(number), fontsize=8, color="0.1", ha="center", va="center")


def _draw_placed(axes: Axes, mesh: PatternMesh) -> None:
    """The placed panels seen from the wearer's left front, a little from above, far panels first."""
    world = mesh.placed()
    across, up = np.array([0.82, 0.0, -0.57]), np.array([-0.17, 0.954, -0.245])
    toward = np.cross(across, up)
    depth = [float((world[mesh.panel == number] @ toward).mean()) for number in range(len(mesh.pattern.panels))]
    x, y = world @ across, world @ up
    colours = _colours(len(depth))
    for number in np.argsort(depth):
        triangles = mesh.panel_faces[mesh.face_panel == number]
        shade = np.full(len(triangles), float(number))
        axes.tripcolor(x, y, triangles, facecolors=shade, cmap=ListedColormap([colours[number]]), alpha=0.45)
    for first, second in mesh.seam_pairs[::4]:
        axes.plot(x[[first, second]], y[[first, second]], color="0.4", linewidth=0.3)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title("as placed, threads of the stitches")
