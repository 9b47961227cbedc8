"""A contact sheet: shaded pictures of cloth, a row for each garment and a column for each tier."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drape.errors import Unavailable

SIDE_PX = 420
Picture = tuple[str, np.ndarray, np.ndarray]  # words, vertices [m] (V, 3), faces (F, 3)


def draw_sheet(pictures: Mapping[tuple[str, str], Picture], path: Path) -> None:
    """Draws ``pictures``, by the names of their row and column, side by side into the PNG file ``path``. Raises
    ``Unavailable`` without PyVista."""
    try:
        import pyvista
    except ImportError as error:
        raise Unavailable("pictures", expected="PyVista", got=str(error), cure="pip install pyvista") from error
    rows, columns = (list(dict.fromkeys(key[place] for key in pictures)) for place in (0, 1))
    size = [SIDE_PX * len(columns), SIDE_PX * len(rows)]
    plotter: Any = pyvista.Plotter(off_screen=True, shape=(len(rows), len(columns)), border=False, window_size=size)
    for (row, column), (words, vertices, faces) in pictures.items():
        plotter.subplot(rows.index(row), columns.index(column))
        mesh = pyvista.PolyData.from_regular_faces(vertices, faces)
        plotter.add_mesh(mesh, color="#b9c4d6", smooth_shading=False, specular=0.1)
        plotter.add_text(f"{row} {column} {words}", font_size=7, color="black")
        plotter.set_background("white")
        plotter.view_vector((0.5, 0.25, 1.0), viewup=(0.0, 1.0, 0.0))
        plotter.camera.zoom(1.3)
    plotter.screenshot(path)
    plotter.close()
