"""The engine's records have one home, and a library that does not fit is refused in a sentence."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drape.engine import build, library, records
from drape.engine.build import TARGETS, is_made_from, sources_hash
from drape.engine.calls import call
from drape.engine.library import LIBRARIES, has_tiles, library_name, load, processor_level
from drape.engine.packer import Record
from drape.errors import ArtifactError


@pytest.mark.parametrize("tests", [False, True])
def test_the_libraries_are_compiled_of_these_sources(tests: bool):
    """Else a header that was changed would be tested as it was before."""
    name = library_name(processor_level()[0], os.environ.get("DRAPE_ISA") or None)
    target = next(target for target in TARGETS[build.host()] if target.name == name)
    path = LIBRARIES / f"{name}{'-tests' if tests else ''}{target.suffix}"
    made_from = [sources_hash(target, tests, sanitize) for sanitize in (False, True)]
    assert any(is_made_from(path, sources) for sources in made_from), "run drape/engine/build.py --tests"


def test_the_build_writes_the_header_of_the_table_and_leaves_one_that_is(monkeypatch, tmp_path: Path):
    monkeypatch.setattr(build, "HEADER", tmp_path / "records.hpp")
    build.write_header()
    assert build.HEADER.read_text() == records.header()
    before = build.HEADER.stat().st_ino
    build.write_header()
    assert build.HEADER.stat().st_ino == before
    build.HEADER.write_text("of another table")
    build.write_header()
    assert build.HEADER.read_text() == records.header() and list(tmp_path.iterdir()) == [build.HEADER]


def test_a_record_has_the_words_of_its_fields():
    corner, numbers = np.arange(8, dtype=np.int32), np.ones(2, np.float32)
    creases = SimpleNamespace(corner=corner, stiffness=numbers, cosine=numbers, sine=numbers)
    made = Record("Creases", creases, np.float32)
    words = np.ctypeslib.as_array((ctypes.c_uint64 * records.size("Creases")).from_address(made.address))
    assert words.tolist() == [corner.ctypes.data, 8, *(3 * [numbers.ctypes.data, 2])]


def test_rows_of_blocks_are_a_record_that_may_end_otherwise():
    points, samples, added = np.ones((4, 5, 3), np.float32), np.ones((2, 5), np.int32), np.ones((1, 7, 3), np.float32)
    names = [*records.RECORDS["FoldMemory"]]
    fields = dict(zip(names, (*points, *samples, *added, 3, 0.25), strict=True))
    made = Record("FoldMemory", SimpleNamespace(**fields))
    rows = Record.of_rows((points, samples, added), 0, np.inf)
    for one in (rows.ending(3, 0.25), Record.of_rows((points, samples, added), 3, 0.25)):
        assert one._words == made._words != rows._words


@pytest.mark.parametrize("wrong", [np.zeros(4), np.zeros(8, np.int32)[::2]])
def test_an_array_of_another_kind_is_our_own_mistake(wrong):
    whole = np.zeros(4, np.float32)
    with pytest.raises(TypeError, match="corner"):
        Record("Creases", SimpleNamespace(corner=wrong, stiffness=whole, cosine=whole, sine=whole), np.float32)


@pytest.mark.parametrize(
    ("level", "forced", "name"),
    [
        (0, None, "arm64"),
        (4, None, "x86-64-v4"),
        (4, "v2", "x86-64-v2"),
        (3, "v3", "x86-64-v3"),
        (2, None, "x86-64-v2"),
    ],
)
def test_the_library_is_that_of_the_processor_or_a_lower_one(level, forced, name):
    assert library_name(level, forced) == f"engine-{name}"


@pytest.mark.parametrize(("level", "forced"), [(1, None), (3, "v4"), (4, "avx512")])
def test_what_a_processor_cannot_run_is_refused(level, forced):
    with pytest.raises(ArtifactError, match="DRAPE_ISA"):
        library_name(level, forced)


def test_a_library_for_lower_processors_has_no_tiles(monkeypatch):
    monkeypatch.setenv("DRAPE_ISA", "v2")
    assert not has_tiles.__wrapped__()


def test_a_folder_without_a_library_is_refused_with_the_cure(tmp_path):
    with pytest.raises(ArtifactError, match=r"drape\.engine\.build"):
        processor_level(tmp_path)
    with pytest.raises(ArtifactError, match=r"drape\.engine\.build"):
        load(folder=tmp_path)


def test_a_library_of_other_records_is_refused_with_the_cure(monkeypatch):
    monkeypatch.setattr(library, "HASH", library.HASH ^ 1)
    with pytest.raises(ArtifactError, match=r"that of this version, got another one: engine-.*drape\.engine\.build"):
        load.__wrapped__()


def test_numbers_of_another_kind_are_our_own_mistake():
    x = np.zeros(2)
    with pytest.raises(TypeError, match="expected float64, got float32"):
        call("law_exponentials", x.dtype, x.astype(np.float32), len(x), x, x)


def test_a_library_is_known_by_its_sources_and_by_how_it_was_made(tmp_path: Path):
    target, engine = TARGETS["linux-aarch64"][0], tmp_path / "engine.so"
    plain, checked = sources_hash(target), sources_hash(target, sanitize=True)
    assert plain != checked and plain != sources_hash(target, tests=True)
    engine.with_name("engine.so.sources").write_text(plain)
    assert not is_made_from(engine, plain), "there is no library"
    engine.touch()
    assert is_made_from(engine, plain) and not is_made_from(engine, checked)
