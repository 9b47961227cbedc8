"""The outfits benchmark: its quick run on the small network, its measures, what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.quality import outfits
from benchmarks.quality.outfits import inner_out_pct, open_engine, open_outfit
from drape.body.assets import load_body
from drape.errors import InputError
from drape.geometry import meshes
from service.engine import PUSH_OVER
from tests.fixtures.packed import exported


def plane(height: float, size: float) -> tuple[np.ndarray, np.ndarray]:
    """A square of triangles in the plane y = ``height``, facing up."""
    side = np.linspace(-size, size, 9)
    x, z = np.meshgrid(side, side, indexing="ij")
    vertices = np.stack([x.reshape(-1), np.full(81, height), z.reshape(-1)], axis=1)
    corner = (9 * np.arange(8)[:, None] + np.arange(8)).reshape(-1)
    faces = np.concatenate([
        np.stack([corner, corner + 1, corner + 10], axis=1), np.stack([corner, corner + 10, corner + 9], axis=1)
    ])  # fmt: skip
    assert meshes.face_normals(vertices, faces)[:, 1].min() > 0.99
    return vertices, faces


def test_what_shows_is_counted_within_reach_and_not_beside():
    outer, faces = plane(0.0, 1.0)
    inner = np.array([[0.1, 0.01, 0.1], [0.1, -0.01, 0.1], [0.1, 0.5, 0.1], [1.5, 0.01, 0.0]])
    assert_allclose(inner_out_pct(inner[None], outer[None], faces), [25.0])


@pytest.mark.slow
def test_the_quick_run_measures_both_ways(tmp_path):
    folder = exported()[1]
    drawn = tmp_path / "outfit.png"
    chosen = ["--model", str(folder), "--outfits", "tank+shorts", "--picture", str(drawn)]
    record = outfits.main(["--quick", "--threads", "1", *chosen])
    assert drawn.read_bytes()[1:4] == b"PNG"
    alone, over = record["rows"]
    assert (alone["method"], over["method"]) == ("alone", "over")
    assert over["through_pct"] <= alone["through_pct"]
    assert alone["edge_added_pp"] == 0.0 and over["p50_ms"] > 0.0
    assert over["times_singles"] > 0.0 and over["prepared_s"] > 0.0


def test_an_outfit_is_two_garments():
    for text in ("tank", "tank+shorts+tshirt"):
        with pytest.raises(InputError, match="inner\\+outer"):
            open_outfit(text, load_body())
    inner, outer = open_outfit("tank+shorts", load_body())
    assert (inner.name, outer.name) == ("tank", "shorts")


@pytest.mark.slow
def test_a_model_that_has_the_graphs_is_used_where_it_lies(tmp_path):
    engine = open_engine(exported()[1], tmp_path, 1)
    assert PUSH_OVER in engine.manifest.graphs and not any(tmp_path.iterdir())
