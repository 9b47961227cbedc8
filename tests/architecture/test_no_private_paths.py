"""Nothing in the repository points at one person's machine."""

from __future__ import annotations

import re

from tests.architecture.repository import ROOT, text_files

# Spelled in pieces, so that this file does not find itself.
PRIVATE = re.compile(
    "|".join(["/wo" + r"rk/(?!flow)", r"\.\./sha" + "red", "/ho" + r"me/[a-z]", "/ro" + r"ot/", "/Us" + "ers/"])
)


def test_no_text_file_names_a_private_path():
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()[:100]}"
        for path, text in text_files()
        for number, line in enumerate(text.splitlines(), start=1)
        if PRIVATE.search(line)
    ]
    assert found == []
