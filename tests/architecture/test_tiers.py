"""Statements of README and docs about the tiers agree with the shipped model's manifest.

A page states a tier as ``TIER`` = CORRECTIONS and N step(s) of folds: "`balanced` = all corrections and 1 step of
folds". Where "the default" stands before it, the tier is also the one of requests that name none.
"""

from __future__ import annotations

import json
import re

from drape.artifacts import DEFAULT_MODEL, MODELS_DIR
from service.settings import Settings
from tests.architecture.repository import ROOT, repository_files

TOLD_ON = ("README.md", "docs/explanation/folds.md")
STATED = re.compile(
    r"(\bthe\s+default\b[^`]{0,20})?`(\w+)`\s+=\s+(all|no|\d+)\s+corrections?\s+and\s+(\d+)\s+steps?\s+of\s+folds",
    re.IGNORECASE,
)
DEFAULT = Settings.model_fields["tier"].default
TIERS = json.loads((MODELS_DIR / DEFAULT_MODEL / "manifest.json").read_text(encoding="utf-8"))["tiers"]
WORDS = {None: "all", 0: "no"}  # of passes; 1 and more are numbers
TRUE = {
    (tier["name"], WORDS.get(passes, str(passes)), str(tier["folds"]))
    for tier in TIERS
    for passes in [tier["passes" if tier["folds"] else "alone"]]
}
PAST = re.compile(r"docs/archive/|docs/log|CHANGELOG")  # true on their day
CURRENT = {
    name: path.read_text("utf-8")
    for path in repository_files()
    if path.suffix == ".md" and not PAST.match(name := path.relative_to(ROOT).as_posix())
}


def false_statements(text: str) -> list[str]:
    """The statements in ``text`` that the manifest or the service's settings contradict."""
    return [
        said[0]
        for said in STATED.finditer(text)
        if (said[2], said[3].lower(), said[4]) not in TRUE or (said[1] and said[2] != DEFAULT)
    ]


def test_pages_state_the_tiers_of_the_manifest():
    assert {name: found for name, text in CURRENT.items() if (found := false_statements(text))} == {}
    for page in TOLD_ON:
        assert DEFAULT in {said[2] for said in STATED.finditer(CURRENT[page])}
