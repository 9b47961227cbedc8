"""A file has one subject; past 400 lines it has two."""

from __future__ import annotations

from tests.architecture.repository import ROOT, repository_files

LINE_LIMIT = 400


def test_no_python_file_is_longer_than_the_limit():
    lengths = {
        str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines())
        for path in repository_files()
        if path.suffix == ".py"
    }
    assert lengths
    assert {name: length for name, length in lengths.items() if length > LINE_LIMIT} == {}
