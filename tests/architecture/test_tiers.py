"""Statements of README and docs about the tiers agree with the shipped model's manifest.

A page states a tier in a fixed form, ``TIER`` = CORRECTIONS and N step(s) of folds, for example "`balanced` = all
corrections and 1 step of folds". CORRECTIONS is "all corrections", "no corrections" or "N correction(s)"; where "the
default" stands before it, the tier is also the one that the service takes for requests that name none.
"""

from __future__ import annotations

import json
import re
from typing import Any, NamedTuple

from drape.artifacts import DEFAULT_MODEL, MODELS_DIR
from service.settings import Settings
from tests.architecture.repository import ROOT, repository_files
from tests.fixtures.laws import each

TOLD_ON = ("README.md", "docs/explanation/folds.md")
STATED = re.compile(
    r"(?P<default>\bthe\s+default\b[^`]{0,20})?`(?P<tier>\w+)`\s+=\s+(?P<corrections>all|no|\d+)\s+corrections?"
    r"\s+and\s+(?P<folds>\d+)\s+steps?\s+of\s+folds",
    re.IGNORECASE,
)


class Statement(NamedTuple):
    """A tier as a page states it: ``passes`` of the network, None for all, under steps of ``folds`` or, 0, alone."""

    tier: str
    passes: int | None
    folds: int
    default: bool


def statements(text: str) -> list[Statement]:
    """The statements about tiers in the Markdown ``text``."""
    said: dict[str, int | None] = {"all": None, "no": 0}
    return [
        Statement(
            tier=found["tier"],
            passes=said[word] if (word := found["corrections"].lower()) in said else int(word),
            folds=int(found["folds"]),
            default=found["default"] is not None,
        )
        for found in STATED.finditer(text)
    ]


def shipped_tiers() -> dict[str, dict[str, Any]]:
    """The tiers of the shipped model's manifest by name."""
    manifest = json.loads((MODELS_DIR / DEFAULT_MODEL / "manifest.json").read_text(encoding="utf-8"))
    return {tier["name"]: tier for tier in manifest["tiers"]}


def false_statements(text: str) -> list[Statement]:
    """The statements in ``text`` that the manifest or the service's settings contradict."""
    tiers, default = shipped_tiers(), Settings.model_fields["tier"].default
    return [
        one
        for one in statements(text)
        if one.tier not in tiers
        or (one.passes, one.folds) != (tiers[one.tier]["passes" if one.folds else "alone"], tiers[one.tier]["folds"])
        or (one.default and one.tier != default)
    ]


PAST = re.compile(r"docs/archive/|docs/log|CHANGELOG")  # true on their day
CURRENT = {
    name: path.read_text("utf-8")
    for path in repository_files()
    if path.suffix == ".md" and not PAST.match(name := path.relative_to(ROOT).as_posix())
}


def test_pages_state_the_tiers_of_the_manifest():
    assert {name: found for name, text in CURRENT.items() if (found := false_statements(text))} == {}


@each(page=TOLD_ON)
def test_the_default_is_stated_where_readers_look_for_it(page: str):
    default = Settings.model_fields["tier"].default
    assert default in {one.tier for one in statements(CURRENT[page])}


@each(
    said=[
        "`balanced` = 1 correction and 5 steps of folds",
        "The default, `balanced` = 1\ncorrection and 5 steps of folds.",
        "`accurate` = all corrections and 5 steps of folds; `fast` = no corrections and 2 steps of folds",
        "`instant` = 1 correction and 0 steps of folds",
    ]
)
def test_a_true_statement_is_read_and_kept(said: str):
    assert statements(said) and false_statements(said) == []


@each(
    said=[
        "`balanced` = all corrections and 4 steps of folds",
        "`balanced` = no corrections and 1 step of folds",
        "`balanced` = all corrections and 1 step of folds",
        "`quick` = all corrections and 1 step of folds",
        "`instant` = no corrections and 0 steps of folds",
        "the default `fast` = no corrections and 2 steps of folds",
    ]
)
def test_a_false_statement_is_seen(said: str):
    assert len(false_statements(said)) == 1
