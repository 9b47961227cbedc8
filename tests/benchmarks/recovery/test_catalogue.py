"""What the catalogue is judged by: ripples of known height, cloth that cuts the body, a picture that shows folds."""

from __future__ import annotations

import json

import numpy as np
from numpy.testing import assert_allclose

from benchmarks.recovery.catalogue import colliding_triangles, detail_mm, pictures
from drape.body.assets import load_body


def sheet_of_cloth(height, count: int = 61, size_m: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """A square sheet before the body whose depth is ``height`` (x, y)."""
    line = np.linspace(-0.5 * size_m, 0.5 * size_m, count)
    x, y = (grid.reshape(-1) for grid in np.meshgrid(line, line, indexing="ij"))
    a = (count * np.arange(count - 1)[:, None] + np.arange(count - 1)).reshape(-1)
    faces = np.concatenate([np.stack([a, a + count, a + 1], 1), np.stack([a + 1, a + count, a + count + 1], 1)])
    return np.stack([x, y + 0.1, height(x, y)], axis=1), faces


def test_ripples_finer_than_five_centimetres_are_detail_and_broad_waves_are_not():
    fine = detail_mm(*sheet_of_cloth(lambda x, y: 0.3 + 5e-4 * np.sin(2.0 * np.pi * x / 0.03)))
    broad = detail_mm(*sheet_of_cloth(lambda x, y: 0.3 + 0.002 * np.sin(2.0 * np.pi * x / 0.25)))
    flat = detail_mm(*sheet_of_cloth(lambda x, y: 0.3 + 0.0 * x))
    # 0.5 mm of amplitude are 0.35 mm, of which a wave of 3 cm loses 1 / (1 + (5 / 3)^4). Borders shrink in all alike.
    assert_allclose(np.sqrt(fine**2 - flat**2), 0.5 / np.sqrt(2.0) * (1.0 - 1.0 / (1.0 + (5.0 / 3.0) ** 4)), rtol=0.15)
    assert np.sqrt(max(broad**2 - flat**2, 0.0)) < 0.25


def test_cloth_through_the_body_is_counted_and_cloth_before_it_is_not():
    body = load_body()
    through, faces = sheet_of_cloth(lambda x, y: 0.0 * x)
    assert colliding_triangles(through, faces, body) > 100
    assert colliding_triangles(through + np.array([0.0, 0.0, 0.5]), faces, body) == 0


def test_pictures_show_three_sides(tmp_path):
    vertices, faces = sheet_of_cloth(lambda x, y: 0.3 + 0.01 * np.sin(2.0 * np.pi * x / 0.1), count=21)
    path = tmp_path / "sheet.obj"
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    path.write_text("\n".join(lines + [f"f {a} {b} {c}" for a, b, c in faces + 1]))
    path.with_suffix(".json").write_text(json.dumps({}))
    views = pictures(path, load_body(), 60)
    assert len(views) == 3 and all(view.shape == (60, 60, 3) for view in views)
    assert np.ptp(views[0][25:35, 25:35]) > 0.1  # light from the side shows the ripples
