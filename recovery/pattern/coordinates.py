"""The mesh of a panel as a linear function of its control points: curves, then mean value coordinates inside.

A boundary point keeps its place on its edge's curve; an inner point is a fixed mean of the boundary points (Floater
2003; Hormann and Floater 2006 for any simple polygon). Neither changes while control points move, so the mesh
is W @ controls and its derivative is W.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import igl
import numpy as np

from recovery.pattern import geometry
from recovery.pattern.sewing_pattern import Edge, EdgeKind, Panel, Pattern


@dataclass(frozen=True, eq=False)
class Controls:
    """The K control points of a pattern, panel by panel, in the order of the outline.

    ``positions`` [m] (K, 2) lie in the panels' frames; ``panel`` (K,) is the number of the panel; ``edge`` (K,) is the
    number of the panel's edge that a corner begins, or to which a handle belongs; ``handle`` (K,) is 0 for a corner, 1
    or 2 for a handle of a Bezier edge. Curves without a handle here follow their chord; arcs always do.
    """

    positions: np.ndarray
    panel: np.ndarray
    edge: np.ndarray
    handle: np.ndarray

    def __len__(self) -> int:
        return len(self.positions)


def control_points(pattern: Pattern, *, free_curves: bool = False) -> Controls:
    """Returns the control points of ``pattern``: its corners, and with ``free_curves`` the handles of its Bezier
    edges."""
    positions, rows = [], []
    for panel_number, panel in enumerate(pattern.panels):
        for number, edge in enumerate(panel.edges):
            handles = len(edge.handles) if free_curves and edge.kind is not EdgeKind.CIRCLE else 0
            positions.append(geometry.edge_controls(panel, number)[: 1 + handles])
            rows += [(panel_number, number, place) for place in range(1 + handles)]
    panel_index, edge_index, handle_index = np.array(rows, dtype=np.int64).T
    return Controls(np.concatenate(positions), panel_index, edge_index, handle_index)


def with_controls(pattern: Pattern, controls: Controls, positions: np.ndarray) -> Pattern:
    """Returns ``pattern`` with its control points at ``positions`` [m] (K, 2), in the order of ``controls``."""
    panels = []
    for panel_number, panel in enumerate(pattern.panels):
        mine = controls.panel == panel_number
        vertices = panel.vertices.copy()
        corner = mine & (controls.handle == 0)
        starts = np.array([edge.start for edge in panel.edges])
        vertices[starts[controls.edge[corner]]] = positions[corner]
        edges = list(panel.edges)
        for number, edge in enumerate(panel.edges):
            handles = positions[mine & (controls.edge == number) & (controls.handle > 0)]
            if len(handles):
                handles = geometry.on_chord(handles, vertices[edge.start], vertices[edge.end])
                edges[number] = replace(edge, handles=handles)
        panels.append(replace(panel, vertices=vertices, edges=tuple(edges)))
    return replace(pattern, panels=tuple(panels))


def edge_point_matrix(edge: Edge, t: np.ndarray) -> np.ndarray:
    """Returns the matrix (2 T, 4) that gives points of ``edge`` at the parameters ``t`` (T,) from its start and its
    end.

    Coordinates are interleaved, x before y. A curve follows its chord: it needs the chord turned left, which mixes x
    and y.
    """
    along, left = geometry.relative_curve(edge, np.asarray(t, dtype=np.float64)).T
    turned = np.array([[0.0, -1.0], [1.0, 0.0]])
    from_end = np.kron(along[:, None], np.eye(2)) + np.kron(left[:, None], turned)
    from_start = np.kron(np.ones((len(t), 1)), np.eye(2)) - from_end
    return np.concatenate([from_start, from_end], axis=1)


def boundary_matrix(panel: Panel, parameters: list[np.ndarray]) -> np.ndarray:
    """Returns the matrix (2 B, 2 C) that gives B boundary points of ``panel``, in the order of the outline, from its C
    corners.

    Coordinates are interleaved, x before y. ``parameters`` holds for each edge the t of its points from the start on,
    the end left out.
    """
    corners = len(panel.edges)
    matrix = np.zeros((2 * sum(len(t) for t in parameters), 2 * corners))
    row = 0
    for number, (edge, t) in enumerate(zip(panel.edges, parameters, strict=True)):
        ends = np.array([number, (number + 1) % corners])
        columns = (2 * ends[:, None] + np.arange(2)).reshape(-1)
        matrix[row : row + 2 * len(t), columns] += edge_point_matrix(edge, t)
        row += 2 * len(t)
    return matrix


def mean_value_weights(points: np.ndarray, cage: np.ndarray) -> np.ndarray:
    """Returns weights (N, M) that give each of ``points`` [m] (N, 2) as a mean of the corners of a polygon ``cage`` [m]
    (M, 2).

    Rows sum to one and reproduce linear functions; on a side they interpolate its ends. In a polygon that is not convex
    some are negative.
    """
    return np.asarray(igl.mvc(np.ascontiguousarray(points), np.ascontiguousarray(cage)))
