"""What the product can be asked for is what the list says: nothing is lost or added unnoticed."""

from __future__ import annotations

from tests.fixtures.capabilities import LIST, capabilities


def test_what_may_be_asked_is_what_the_list_says():
    listed, there = set(LIST.read_text(encoding="utf-8").splitlines()), set(capabilities())
    cure = "if that is meant: python -m tests.fixtures.capabilities"
    assert (sorted(listed - there), sorted(there - listed)) == ([], []), cure
