"""Fit: figures of regions, the words for them, and a tube that is worn wider than it is."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.cloth.fabric_table import fabric
from drape.cloth.tension import Tension
from drape.garment.cache import Garment
from drape.garment.ease import Ease
from drape.garment.fit_report import REGIONS, JudgedDrape, Region, fit_report, fit_words, region_figures, regions_of
from tests.fixtures.garments import shipped

EVEN = Region(area_m2=0.2, warp=0.0, weft=0.0, high=0.0, touching=0.5, pressure_n_per_m2=0.0, gap_m=0.01)
FITS = "fits: nothing pulls, and nothing stands far off"


def test_every_joint_has_one_region():
    named = [joint for joints in REGIONS.values() for joint in joints]
    assert sorted(named) == sorted(JOINT_NAMES)


def test_regions_follow_the_bones_and_the_seat_belongs_to_the_hips(body: BodyModel):
    trousers = shipped("slim_trousers")
    named, names = regions_of(trousers, body), list(REGIONS)
    heights = {
        name: trousers.vertices[named == number, 1] for number, name in enumerate(names) if (named == number).any()
    }
    assert {"hips", "thighs", "lower legs"} <= set(heights) <= {"waist", "hips", "thighs", "lower legs"}
    assert heights["thighs"].max() < heights["hips"].min() + 0.15
    assert heights["lower legs"].mean() < heights["thighs"].mean() < heights["hips"].mean()


def test_figures_are_means_by_area_and_small_strips_are_left_out():
    area = np.array([0.01, 0.03, 0.02, 0.001])
    tension = Tension(np.array([0.1, 0.2, 0.0, 9.0]), np.array([0.0, 0.04, 0.3, 9.0]), np.array([0.0, 40.0, 0.0, 9.0]))
    chest, waist, neck = (list(REGIONS).index(name) for name in ("chest", "waist", "neck"))
    touching = np.array([False, True, False, True])
    found = region_figures(
        np.array([chest, chest, waist, neck]), area, tension, touching=touching, gap_m=np.array([0.02, 0.0, 0.1, 0.0])
    )
    assert list(found) == ["chest", "waist"], "from top to bottom"
    assert_allclose(found["chest"], [0.04, 0.175, 0.03, 0.2, 0.75, 40.0, 0.005], rtol=1e-12)
    assert_allclose(found["waist"], [0.02, 0.0, 0.3, 0.3, 0.0, 0.0, 0.1], rtol=1e-12)


@pytest.mark.parametrize(
    ("region", "words"),
    [
        ({"weft": 0.06, "warp": 0.02}, ["tight across the chest: 6 % along the weft"]),
        ({"weft": 0.02, "warp": 0.14}, ["very tight across the chest: 14 % along the warp"]),
        ({"weft": 0.06, "touching": 0.1}, [FITS]),  # it hangs
        ({"weft": 0.02}, [FITS]),
        ({"gap_m": 0.05}, [FITS]),  # of the trunk ease tells
    ],
)
def test_words_say_what_is_tight(region: dict[str, float], words: list[str]):
    assert fit_words({"chest": EVEN._replace(**region)}, {}) == words


def test_words_say_what_is_too_small_or_loose():
    assert fit_words({}, {"hip_m": Ease(1.0, 0.96)}) == ["too small at the hips: 4 cm less than the body"]
    assert fit_words({}, {"hip_m": Ease(1.0, 0.997)}) == [FITS]
    assert fit_words({}, {"chest_m": Ease(1.0, 1.08)}) == [FITS]
    assert fit_words({}, {"chest_m": Ease(1.0, 1.17)}) == ["loose at the chest: 17 cm of ease"]
    assert fit_words({"thighs": EVEN._replace(gap_m=0.04)}, {}) == ["loose around the thighs: 4 cm off the skin"]


def test_a_tube_as_it_is_fits_loosely(body: BodyModel, tube: Garment):
    found = fit_report(tube, body, JudgedDrape(np.zeros(10), tube.vertices.astype(np.float64)))
    assert_allclose([found.tension.warp, found.tension.weft], 0.0, atol=1e-5)
    assert found.words == [f"loose at the waist: {100 * found.ease['waist_m'].ease_m:.0f} cm of ease"]
    assert set(found.regions) <= {"chest", "waist", "hips"}


def test_a_tube_that_is_stretched_by_the_body_is_tight_and_presses(body: BodyModel, tube: Garment):
    middle = tube.vertices.mean(axis=0) * [1.0, 0.0, 1.0]
    rest = tube.vertices.astype(np.float64)
    tight = (rest - middle) * [1.08, 1.0, 1.08] + middle
    wide = np.array([2.0, 0.0, 0.0])  # a body that comes to lie at the cloth and beyond it
    found = fit_report(tube, body, JudgedDrape(wide, tight))
    assert_allclose(found.tension.weft, 0.08, atol=1e-5)
    assert any(word.startswith("tight across the ") and word.endswith(": 8 % along the weft") for word in found.words)
    assert found.tension.pressure.max() > 0.0
    stiff = fit_report(tube, body, JudgedDrape(wide, tight), fabric=fabric("denim"))
    assert stiff.tension.pressure.max() > found.tension.pressure.max()
    assert stiff.ease == found.ease


def test_strain_is_that_of_the_pose_and_ease_that_of_rest(body: BodyModel, tube: Garment):
    rest, pose = tube.vertices.astype(np.float64), np.zeros((24, 3))
    pose[0, 1] = 0.5 * np.pi  # the body turns and the cloth is longer
    turned = body.posed_vertices(pose[None])[0]
    assert np.abs(turned - body.v_template).max() > 0.1
    found = fit_report(tube, body, JudgedDrape(np.zeros(10), rest, pose, rest * [1.0, 1.1, 1.0]))
    assert_allclose(found.tension.warp, 0.1, atol=1e-5)
    assert found.ease == fit_report(tube, body, JudgedDrape(np.zeros(10), rest)).ease
