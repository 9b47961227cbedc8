"""The cloth's constants."""

from __future__ import annotations

from dataclasses import replace

import pytest
from numpy.testing import assert_allclose

from drape.cloth import fabric_table
from drape.cloth.fabric_table import fabric
from drape.cloth.material import FABRICS, MEASURED, Material, material, worn_fabric
from drape.errors import InputError, NotFound


def test_default_is_the_jersey_of_the_design():
    jersey = material()
    assert jersey == Material()
    assert jersey.warp_n_per_m == jersey.weft_n_per_m == 2.0 * 11.1 + 20.9
    assert (jersey.shear_n_per_m, jersey.cross_n_per_m, jersey.contact_gap_m) == (4.0 * 11.1, 20.9, 0.004)


def test_soft_and_stiff_scale_membrane_and_bending_and_nothing_else():
    for name, factor in (("soft", 1.0 / 3.0), ("stiff", 3.0)):
        scaled, jersey = material(name), material()
        for field in ("warp_n_per_m", "weft_n_per_m", "cross_n_per_m", "shear_n_per_m", "bending_j"):
            assert_allclose(getattr(scaled, field), factor * getattr(jersey, field), rtol=1e-15, atol=0.0)
        assert scaled.density_kg_m2 == jersey.density_kg_m2
        assert scaled.contact_j_m4 == jersey.contact_j_m4


def test_limp_and_crisp_differ_in_bending_alone():
    for name, factor in (("limp", 0.2), ("crisp", 5.0)):
        assert_allclose(material(name).bending_j, factor * material().bending_j, rtol=1e-15, atol=0.0)
        assert replace(material(name), bending_j=material().bending_j) == material()


def test_the_fabrics_of_the_table_have_their_names_but_for_a_second_jersey():
    assert material("interlock") == Material.of(fabric("jersey")) != material("jersey")
    assert material("rib") == Material.of(fabric("rib"))


@pytest.mark.parametrize(
    ("name", "worn"),
    [("jersey", "jersey"), ("interlock", "jersey"), ("rib", "rib"), ("stiff", "denim"), ("soft", "jersey")],
)
def test_a_garment_is_worn_in_the_fabric_that_is_nearest(name: str, worn: str):
    assert worn_fabric(name) == worn and worn in fabric_table.FABRICS
    assert len(MEASURED) == len(fabric_table.FABRICS) and not MEASURED.keys() & FABRICS.keys()


def test_unknown_name_is_refused():
    with pytest.raises(NotFound, match="jersey"):
        material("chain mail")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("warp_n_per_m", 0.0),
        ("density_kg_m2", 0.0),
        ("bending_j", -1.0),
        ("contact_j_m4", float("nan")),
        ("cross_n_per_m", float("inf")),
    ],
)
def test_unphysical_constants_are_refused(field, value):
    with pytest.raises(InputError, match=field):
        Material(**{field: value})
