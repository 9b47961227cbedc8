"""Contact sheets have a picture for each row and column."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.measure.contact_sheet import SIDE_PX, draw_sheet
from drape.errors import Unavailable
from tests.drape.cloth.cloth_shapes import grid


def test_a_sheet_has_a_place_for_each_row_and_column(tmp_path: Path):
    vertices, faces = grid(6, 4, cell_m=0.1)
    path = tmp_path / "sheet.png"
    draw_sheet({("tank", "fast"): ("walk 1.0", vertices, faces), ("skirt", "exact"): ("turn", vertices, faces)}, path)
    drawn = np.asarray(Image.open(path).convert("L"))
    assert drawn.shape == (2 * SIDE_PX, 2 * SIDE_PX)
    dark = [[(part < 250).mean() for part in np.split(row, 2, axis=1)] for row in np.split(drawn, 2)]
    assert dark[0][0] > 0.01 < dark[1][1]


def test_without_pyvista_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(Unavailable, match="PyVista"):
        draw_sheet({}, tmp_path / "sheet.png")
