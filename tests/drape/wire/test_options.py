"""What a client may choose: names in Python and on the wire, limits, and values that can be a key."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from drape.wire.options import DrapeOptions, WornGarments, options_document


def test_names_on_the_wire_are_the_aliases_and_only_what_was_chosen_is_said():
    chosen = {"push_out": False, "knob": 0.0, "passes": None, "geometry": "jets"}
    document = options_document(chosen)
    assert document == {"push_out": False, "motion": 0.0, "geometry": "jets"}
    read = DrapeOptions.model_validate(document)
    assert (read.push_out, read.knob, read.passes, read.geometry) == (False, 0.0, None, "jets")


def test_an_option_that_there_is_not_is_named_with_those_that_there_are():
    known = ", ".join(DrapeOptions.model_fields)
    with pytest.raises(TypeError, match=f"no such option: speed. There are {known}"):
        options_document({"speed": 1})
    with pytest.raises(TypeError, match=r"no such option: fold\. Did you mean folds\?"):
        options_document({"fold": 1})


def test_every_option_is_described_and_may_be_left_out():
    assert all(field.description for field in DrapeOptions.model_fields.values())
    assert DrapeOptions() == DrapeOptions.model_validate({})


def test_equal_options_are_one_key():
    one, other = (DrapeOptions(passes=passes, motion=0.5) for passes in (2, 3))
    assert hash(one) == hash(DrapeOptions(passes=2, motion=0.5))
    assert one == one.model_copy() != other
    with pytest.raises(ValidationError, match="frozen"):
        one.passes = 1  # type: ignore[misc]


@pytest.mark.parametrize(
    "document",
    [
        {"motion": -0.1},
        {"motion": 1.1},
        {"motion": float("nan")},
        {"passes": -1},
        {"passes": 1.5},
        {"geometry": "points"},
    ],
)
def test_values_out_of_range_are_refused(document: dict):
    with pytest.raises(ValidationError):
        DrapeOptions.model_validate(document)


def test_an_outfit_has_a_garment():
    assert WornGarments(garments=["tube"]).garments == ["tube"]
    with pytest.raises(ValidationError):
        WornGarments(garments=[])
