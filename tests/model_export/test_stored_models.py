"""The exported models that tests share are stored: they must be those that this code exports."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fixtures import packed


def test_the_code_that_exports_is_the_code_that_exported_the_stored_models():
    cure = "python -m tests.fixtures.packed stores them anew; until then every run exports them, which takes minutes"
    assert packed.stored_digest() == packed.sources_digest(), cure


def test_words_do_not_count_as_code(tmp_path: Path):
    texts = {
        "plain": "def f(x):\n    return x + 1\n",
        "words": '"""Of f."""\n\n\ndef f(x):  # adds\n    """One more."""\n    return x + 1\n',
        "other": "def f(x):\n    return x + 2\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    plain, words, other = (packed.code_of(tmp_path / name) for name in texts)
    assert plain == words != other


@pytest.mark.long
@pytest.mark.parametrize("name", packed.MADE)
def test_the_stored_graphs_are_traced_from_this_code(name: str, tmp_path: Path):
    packed.write_model(packed.MADE[name](), tmp_path / name)
    for stored in sorted((packed.MODELS / name).glob("*.onnx")):
        assert (tmp_path / name / stored.name).read_bytes() == stored.read_bytes(), stored.name
