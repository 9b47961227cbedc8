"""The benchmark of cuts: what it writes as targets, how the cut that was told is judged, and its pictures."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks import recovery_cuts
from drape.body.model import BodyModel
from drape.garment.files.mesh import read_mesh
from recovery.run.cut import Cut
from recovery.run.report_pictures import MeshArrays, target_above_result
from tests.fixtures.garments import shipped

UNSEEN = ("The target does not show its seams: panels and seams are the base's",)


def test_a_garment_of_the_catalogue_is_a_plain_surface(tmp_path: Path):
    path, source = recovery_cuts.write_target("tank", tmp_path)
    mesh = read_mesh(path)
    assert source == "catalogue" and len(mesh.uv) == 0 and len(mesh.vertices) > 4000
    assert np.ptp(mesh.vertices[:, 1]) == pytest.approx(0.586, abs=0.01)


def test_without_data_the_run_ends_with_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("DRAPE_DATA", raising=False)
    with pytest.raises(SystemExit, match="DRAPE_DATA"):
        recovery_cuts.write_target("tee", tmp_path)


def test_a_cut_is_right_where_base_and_panels_are_or_a_sentence_says_what_is_not_seen():
    assert recovery_cuts.verdict("tshirt", Cut("tshirt", True, {}, ()), panels=True) == "yes"
    assert recovery_cuts.verdict("tshirt", Cut("tank", True, {}, ()), panels=True) == "no, tshirt"
    assert recovery_cuts.verdict("tank", Cut("tank", True, {}, UNSEEN)) == "base; seams unseen"
    assert recovery_cuts.verdict("skirt", Cut("skirt", True, {}, ())) == "base"


def test_a_refusal_is_right_where_it_is_asked_for():
    assert recovery_cuts.verdict("tshirt", None) == "no, tshirt"
    assert recovery_cuts.verdict(recovery_cuts.REFUSED, None) == "yes"
    assert recovery_cuts.verdict(recovery_cuts.REFUSED, Cut("tshirt", True, {}, ())) == "no, refused"


def test_a_target_that_is_refused_has_the_sentence_in_its_row(tmp_path: Path):
    (tmp_path / "t.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    job = recovery_cuts.as_user(tmp_path / "t.obj", tmp_path / "out", "--body", "fit", "--minutes", "6")
    assert (job.body, job.base, job.minutes, job.retarget) == ("fit", None, 6.0, False)
    row = recovery_cuts.recover_job(
        job, lambda cut, panels: recovery_cuts.verdict("tshirt", cut), tmp_path / "pictures"
    )
    assert row["base"] == "refused" and row["told"] == "no, tshirt" and "mean_mm" not in row
    assert row["refused"] and not (tmp_path / "pictures").exists()


def test_a_pair_shows_the_target_above_in_grey_and_what_was_recovered_below_in_another_colour(body: BodyModel):
    tank = shipped("tank")
    cloth, skin = MeshArrays(tank.vertices.astype(float), tank.fine_faces), MeshArrays(body.v_template, body.faces)
    image = np.asarray(Image.open(io.BytesIO(target_above_result(cloth, cloth, skin, (120, 90))))).astype(int)
    above, below = np.split(image, 2)
    differs = (above != below).any(axis=-1)  # where the cloth is: the body is the same in both
    assert above.shape == (120, 90, 3) and 0.05 < differs.mean() < 0.6
    assert np.ptp(above[differs], axis=-1).max() < 20 < np.ptp(below[differs], axis=-1).mean()
