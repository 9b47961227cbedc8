"""The quality table: what it takes, what it refuses, and that its columns mean what they say."""

from __future__ import annotations

import pytest
from numpy.testing import assert_allclose

from benchmarks import quality
from drape.artifacts import DEFAULT_MODEL, MODELS_DIR
from drape.body.assets import load_body
from drape.errors import ArtifactError, InputError, NotFound
from drape.garment.cache import GARMENTS_DIR


def test_names_files_and_folders_are_found(tmp_path):
    for name in ("tank-0123456789abcdef.npz", "long-sleeve.obj", "avatar_female.obj", "notes.txt"):
        (tmp_path / name).touch()
    suffixes = (".npz", ".obj")

    def find(*names):
        return [path.name for path in quality.find_files(names, tmp_path, suffixes, "garment")]

    assert find() == ["long-sleeve.obj", "tank-0123456789abcdef.npz"]
    assert find("tank") == ["tank-0123456789abcdef.npz"]
    assert find("long-sleeve", str(tmp_path / "notes.txt")) == ["long-sleeve.obj", "notes.txt"]
    with pytest.raises(NotFound, match="tank"):
        find("trousers")


def test_what_was_made_for_another_body_is_refused():
    body = load_body()
    quality.check_body("garment", body.digest, body)
    with pytest.raises(ArtifactError, match="garment shirt body"):
        quality.check_body("garment shirt", "0" * 64, body)


def test_summary_takes_the_gain_of_the_mean_energies():
    energy = {"skinning": (2.0, 3.0), "skinning_push": (2.0, 4.0), "network": (1.0, 2.0), "network_push": (1.5, 1.5)}
    rows = [
        {"garment": str(i), "method": method, "energy_j": energy.get(method, (0.5, 0.5))[i], "gain": 9.0}
        for i in range(2)
        for method in quality.METHODS
    ]
    gains = {row["method"]: row["gain"] for row in quality.summary(rows)}
    assert_allclose([gains["skinning_push"], gains["network"], gains["physics"]], [0.0, 0.6, 1.0], rtol=1e-12, atol=0.0)


def test_unusable_garments_are_named(tmp_path, monkeypatch):
    (tmp_path / "shirt.obj").write_text("v 0 0 0\n")
    monkeypatch.setattr(quality, "measure", lambda garment, bench: pytest.fail("measured a broken garment"))
    with pytest.raises(InputError, match="at least one usable"):
        quality.main(["--quick", "--garments", str(tmp_path)])


@pytest.mark.slow
@pytest.mark.skipif(not (MODELS_DIR / DEFAULT_MODEL).is_dir(), reason="no model is shipped: export one")
def test_the_quick_table_is_ordered_as_physics_demands(tmp_path):
    if not any(GARMENTS_DIR.glob("tshirt-*.npz")):
        pytest.skip("no shipped T-shirt: run the intake")
    record = quality.main(["--quick", "--out", str(tmp_path / "quality.json")])
    rows = {row["method"]: row for row in record["rows"]}
    assert tuple(rows) == quality.METHODS
    assert rows["physics"]["gain"] == 1.0
    assert rows["skinning_push"]["gain"] == 0.0
    assert rows["physics"]["energy_j"] < rows["skinning_push"]["energy_j"]
    assert rows["physics"]["edge_pct"] < rows["skinning"]["edge_pct"]
    assert rows["skinning_push"]["colliding_vertex_pct"] < 0.1


def test_options_of_the_quick_form_yield_to_explicit_ones():
    quick = quality.parse(["--quick"])
    assert (quick.garments, quick.frames, quick.steps) == (["tshirt"], quality.QUICK_FRAMES, quality.QUICK_STEPS)
    given = quality.parse(["--quick", "--garments", "dress", "--frames", "3", "--steps", "20"])
    assert (given.garments, given.frames, given.steps) == (["dress"], 3, 20)
    assert quality.parse([]).frames == quality.FRAMES
