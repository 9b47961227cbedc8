"""The error tree: every class says its four things and survives a process boundary."""

from __future__ import annotations

import argparse
import pickle

import pytest

from drape import errors
from drape.errors import DrapeError, did_you_mean, with_numbers_bound

PARTS = {"name": "patch count", "expected": "at most 3", "got": "4", "cure": "Ask for fewer."}
CLASSES = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, DrapeError)]
INPUT_ERRORS = (errors.MeshError, errors.BodyError, errors.MotionError, errors.NotFound)


@pytest.mark.parametrize("kind", CLASSES)
def test_message_says_name_expected_got_and_cure(kind):
    assert str(kind(**PARTS)) == "patch count: expected at most 3, got 4. Ask for fewer."


@pytest.mark.parametrize("kind", CLASSES)
def test_errors_keep_class_and_parts_through_pickling(kind):
    copy = pickle.loads(pickle.dumps(kind(**PARTS)))
    assert type(copy) is kind
    assert {key: getattr(copy, key) for key in PARTS} == PARTS
    assert str(copy) == str(kind(**PARTS))


def test_tree_is_the_one_that_is_drawn():
    drawn = [line.split("|--")[1].split()[0] for line in (errors.__doc__ or "").splitlines() if "|--" in line]
    assert {kind.__name__ for kind in CLASSES} == {"DrapeError", *drawn}
    for kind in INPUT_ERRORS:
        assert kind.__mro__[1] is errors.InputError
    for kind in (errors.InputError, errors.ArtifactError, errors.Unavailable):
        assert kind.__mro__[1] is DrapeError


def test_parts_are_named_not_counted():
    with pytest.raises(TypeError):
        DrapeError("patch count", "at most 3", "4", "Ask for fewer.")  # pyright: ignore[reportCallIssue]


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("tshrt", "tshirt"),
        ("T-Shirt", "tshirt"),
        ("Trousers", "trousers"),
        ("cape", None),
        ("", None),
        ("x" * 999, None),
    ],
)
def test_a_name_that_is_nearly_one_is_told(name: str, near: str | None):
    cure = did_you_mean(name, ["tshirt", "trousers", "dress"], "Look.")
    assert cure == (f"Did you mean {near}? Look." if near else "Look.")


@pytest.mark.parametrize("numbers", ["-1,0.5", "-.5,1", "-1e-3", "-1"])
def test_a_list_of_numbers_may_begin_with_a_minus(numbers: str):
    parser = argparse.ArgumentParser()
    parser.add_argument("--betas")
    parser.add_argument("--still", action="store_true")
    parser.add_argument("rest", nargs="*")
    for words in (["a", "--betas", numbers, "--still"], ["a", f"--betas={numbers}", "--still"]):
        assert vars(parser.parse_args(with_numbers_bound(words))) == {"betas": numbers, "still": True, "rest": ["a"]}
