"""Fabrics by name, by numbers and by laboratory readings."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drape.cloth import material
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_readings import FastReadings, KesReadings, from_fast, from_kes
from drape.cloth.fabric_table import ALIASES, FABRICS, fabric
from drape.errors import InputError, NotFound

KES = KesReadings((4.0, 8.0), (0.6, 1.0), (0.10, 0.05), (0.06, 0.0), 1.0, 12.0, 0.4)
FAST = FastReadings((1.0, 2.0), 3.0, (20.0, 16.0), 200.0, 0.5)
NUMBERS: dict[str, Any] = {
    **{"warp_n_per_m": 500.0, "weft_n_per_m": 400.0, "cross_n_per_m": 20.0, "shear_n_per_m": 100.0},
    **{"bending_warp_j": 1e-5, "bending_bias_j": 8e-6, "bending_weft_j": 9e-6, "density_kg_m2": 0.2},
}


def test_what_a_designer_asks_for_is_there():
    asked = {"jersey", "rib", "ponte", "sweat", "denim", "twill", "poplin", "satin", "chiffon", "swim"}
    assert asked <= set(FABRICS)
    assert all(cloth.name == name and cloth.source for name, cloth in FABRICS.items())


@pytest.mark.parametrize("name", FABRICS)
def test_every_stretch_of_every_fabric_costs_energy(name: str):
    cloth = FABRICS[name]
    strain = np.random.default_rng(0).normal(size=(2, 500))
    energy = (
        cloth.warp_n_per_m * strain[0] ** 2
        + 2.0 * cloth.cross_n_per_m * strain[0] * strain[1]
        + cloth.weft_n_per_m * strain[1] ** 2
    )
    assert energy.min() > 0.0


def test_measured_constants_are_those_of_the_paper_a_quarter_of_the_way():
    jersey = FABRICS["jersey"]
    assert jersey.weft_n_per_m == pytest.approx(2.0 * (0.75 * 16.59 + 0.25 * 97.35))
    assert jersey.warp_n_per_m == pytest.approx(2.0 * (0.75 * 34.48 + 0.25 * 330.56))
    assert jersey.cross_n_per_m == pytest.approx(2.0 * (0.75 * -14.70 + 0.25 * 81.18))
    assert jersey.shear_n_per_m == pytest.approx(4.0 * 36.86)
    assert jersey.bending_warp_j == pytest.approx(30.59e-6 / 4.0)


@pytest.mark.parametrize("old", ALIASES)
def test_names_of_the_old_materials_still_answer_and_say_their_new_one(old: str):
    assert old in material.FABRICS
    with pytest.warns(DeprecationWarning, match=ALIASES[old]):
        assert fabric(old) is FABRICS[ALIASES[old]]


def test_numbers_and_fabrics_are_taken_as_they_are():
    given = fabric(NUMBERS)
    assert given == Fabric(name="given", **NUMBERS)
    assert fabric(given) is given
    assert fabric("denim") is FABRICS["denim"]


def test_unknown_names_and_wrong_fields_are_refused():
    with pytest.raises(NotFound, match=r"expected one of .*'jersey'.*got tweed.*laboratory readings"):
        fabric("tweed")
    with pytest.raises(InputError, match=r"density_kg_m2.*Give the missing fields"):
        fabric({"warp_n_per_m": 500.0})
    with pytest.raises(InputError, match="colour"):
        fabric({**NUMBERS, "colour": 1.0})


def test_kes_readings_in_si_units():
    cloth = from_kes("shirt", KES)
    assert cloth.density_kg_m2 == pytest.approx(0.12)
    assert cloth.thickness_m == pytest.approx(4e-4)
    # 1 gf/(cm deg) is 56.2 N/m per radian, and the energy's constant four times the modulus.
    assert cloth.shear_n_per_m == pytest.approx(4.0 * 56.19, rel=1e-3)
    # Without friction B alone: 0.05 gf cm2/cm; with it HB / (30 1/m) on top.
    assert cloth.bending_weft_j == pytest.approx(0.05 * 9.80665e-5)
    assert cloth.bending_warp_j == pytest.approx(0.10 * 9.80665e-5 + 0.03 * 9.80665e-3 / 30.0)


def test_kes_stretch_is_read_off_the_measured_curve_at_a_garments_load():
    # A straight curve (LT 1) of 8 % at 500 gf/cm: 0.32 % at 20 gf/cm.
    expected = 2.0 * 19.6133 / (0.0032 * 1.0032 * 2.0032)
    assert from_kes("shirt", KES).weft_n_per_m == pytest.approx(expected)
    # One that starts soft (LT 0.6) is softer there than its secant at the end.
    assert from_kes("shirt", KES).warp_n_per_m < 0.5 * 490.3 / 0.04


def test_fast_readings_come_back_from_the_tests_that_gave_them():
    cloth = from_fast("suit", FAST)
    stretch = 1.01
    assert 0.5 * cloth.warp_n_per_m * stretch * (stretch**2 - 1.0) == pytest.approx(20.0 * 0.980665)
    assert (cloth.bending_warp_j / (9.80665 * cloth.density_kg_m2)) ** (1.0 / 3.0) == pytest.approx(0.020)
    # EB5 of 3 % at 4.9 N/m: FAST's formula takes the bias strip for a free one of modulus 4 G.
    assert 4.903 / cloth.shear_n_per_m == pytest.approx(0.03, rel=0.01)


@pytest.mark.parametrize(
    ("readings", "match"),
    [
        (replace(KES, bending=(0.1, -0.1)), "bending: expected a reading > 0"),
        (replace(KES, linearity=(0.6, 2.0)), "linearity: expected a reading > 0, below 2"),
        (replace(KES, weight=float("nan")), "weight"),
        (replace(KES, hysteresis=(-0.01, 0.0)), "hysteresis"),
    ],
)
def test_impossible_readings_are_refused(readings: KesReadings, match: str):
    with pytest.raises(InputError, match=match):
        from_kes("shirt", readings)
    with pytest.raises(InputError, match="bias_extension_pct"):
        from_fast("suit", replace(FAST, bias_extension_pct=0.0))
