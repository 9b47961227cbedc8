"""What a client may choose: names in Python and on the wire, limits, and values that can be a key."""

from __future__ import annotations

import json

import pytest
from pydantic import ValidationError

from drape.wire import options
from drape.wire.options import Advanced, DrapeOptions, WornGarments, options_document

NUMBERS: dict[str, object] = {
    "passes": 2, "folds": 3, "coarse": True, "safe_folds": 4, "settle": 16, "cloth_contact": False, "push_out": False,
    "inertia": "network",
}  # fmt: skip


def test_names_on_the_wire_are_the_aliases_and_only_what_was_chosen_is_said():
    chosen = {"advanced": {"push_out": False}, "knob": 0.0, "tier": None, "geometry": "jets"}
    document = options_document(chosen)
    assert document == {"advanced": {"push_out": False}, "motion": 0.0, "geometry": "jets"}
    read = DrapeOptions.model_validate(document)
    assert (read.advanced, read.knob, read.geometry) == (Advanced(push_out=False), 0.0, "jets")


def test_an_option_that_there_is_not_is_named_with_those_that_there_are():
    known, numbers = (", ".join(model.model_fields) for model in (DrapeOptions, Advanced))
    with pytest.raises(TypeError, match=f"no such option: speed. There are {known}, and in advanced {numbers}"):
        options_document({"speed": 1})
    with pytest.raises(TypeError, match=r"no such option: fold\. Did you mean folds\?"):
        options_document({"fold": 1})


def test_there_are_twelve_options_of_a_drape_and_those_of_experts():
    assert len({*WornGarments.model_fields, *DrapeOptions.model_fields} - {"advanced"}) <= 12
    assert NUMBERS.keys() == Advanced.model_fields.keys()


@pytest.mark.parametrize(("name", "value"), NUMBERS.items())
def test_an_option_of_experts_at_its_old_place_is_the_same_option(name: str, value: object, caplog):
    options._tell_moved.cache_clear()
    flat, deep = DrapeOptions(**{name: value}), DrapeOptions(advanced=Advanced(**{name: value}))  # type: ignore[arg-type]
    assert flat == deep and hash(flat) == hash(deep)
    assert deep == DrapeOptions.model_validate({"advanced": {name: value}, name: value})
    assert deep == DrapeOptions.model_validate({"advanced": {name: value}, name: None})
    assert deep == DrapeOptions.model_validate({"advanced": {name: None}, name: value})
    assert deep == DrapeOptions.model_validate({"advanced": deep.advanced, name: value})
    assert deep == DrapeOptions.model_validate_json(json.dumps({name: value}))
    assert options_document({name: value}) == {name: value}, "a refusal names it as it was written"
    told = [record.getMessage() for record in caplog.records]
    assert told == [f"option {name}: write advanced.{name}; release 0.1 is the last that takes it as it came"]


@pytest.mark.parametrize(
    ("document", "where", "said"),
    [
        ({"folds": 99}, ("folds",), "less than or equal to 16"),
        ({"advanced": {"folds": 99}}, ("advanced", "folds"), "less than or equal to 16"),
        ({"folds": 1, "advanced": {"folds": 2}}, ("folds",), "the value of advanced.folds, or one of the two left out"),
        ({"advanced": {"fold": 1}}, ("advanced", "fold"), "Extra inputs are not permitted"),
        ({"folds": 1, "advanced": {"fold": 1}}, ("advanced", "fold"), "Extra inputs are not permitted"),
        ({"folds": 1, "advanced": 3}, ("advanced",), "a valid dictionary or instance of Advanced"),
        ({"advanced": []}, ("advanced",), "a valid dictionary or instance of Advanced"),
    ],
)
def test_a_refusal_names_an_option_of_experts_as_it_was_written(document: dict, where: tuple, said: str):
    with pytest.raises(ValidationError) as refused:
        DrapeOptions.model_validate(document)
    (fault,) = refused.value.errors()
    assert fault["loc"] == where and said in fault["msg"]


def test_the_schema_tells_old_places_as_deprecated():
    properties = DrapeOptions.model_json_schema()["properties"]
    assert {name for name, told in properties.items() if told.get("deprecated")} == NUMBERS.keys()
    assert all(properties[name]["description"] == f"Old name of advanced.{name}." for name in NUMBERS)


def test_values_are_put_where_they_stand():
    chosen = DrapeOptions(motion=1.0, advanced=Advanced(folds=2)).updated(knob=0.5, passes=1)
    assert chosen == DrapeOptions(motion=0.5, advanced=Advanced(folds=2, passes=1))


def test_every_option_is_described_and_may_be_left_out():
    assert all(field.description for model in (DrapeOptions, Advanced) for field in model.model_fields.values())
    assert DrapeOptions() == DrapeOptions.model_validate({})


def test_equal_options_are_one_key():
    one, other = (DrapeOptions(advanced=Advanced(passes=passes), motion=0.5) for passes in (2, 3))
    assert hash(one) == hash(DrapeOptions(advanced=Advanced(passes=2), motion=0.5))
    assert one == one.model_copy() != other
    with pytest.raises(ValidationError, match="frozen"):
        one.knob = 1.0  # type: ignore[misc]
    with pytest.raises(ValidationError, match="frozen"):
        one.advanced.passes = 1  # type: ignore[misc]


@pytest.mark.parametrize(
    "document",
    [
        {"motion": -0.1},
        {"motion": 1.1},
        {"motion": float("nan")},
        {"advanced": {"passes": -1}},
        {"advanced": {"passes": 1.5}},
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
