"""Clips as files: written whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from drape.errors import InputError, Unavailable
from drape.export.clips import write_pieces


def test_writing_is_all_or_nothing(tmp_path: Path):
    target = tmp_path / "a.glb"
    write_pieces(target, [b"o", b"ne"])
    write_pieces(target, [b"two"])
    assert target.read_bytes() == b"two"
    folder = tmp_path / "folder.glb"
    folder.mkdir()
    with pytest.raises(InputError):
        write_pieces(folder, [b"x"])
    with pytest.raises(InputError, match="can be written"):
        write_pieces(tmp_path / "absent/a.glb", [b"x"])

    def cut_off() -> Iterator[bytes]:
        yield b"half of it"
        raise Unavailable("service", expected="an answer", got="none", cure="Start it.")

    with pytest.raises(Unavailable):
        write_pieces(target, cut_off())
    assert target.read_bytes() == b"two"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.glb", "folder.glb"]
