"""Stored kernels are compiled again when any file of their package has changed, and not before."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = """
from pathlib import Path
import drape.kernels.compiled as original

source = Path(original.__file__).read_text()
module = type(original)("stored.compiled")
module.__file__ = str(Path(__file__).parent / "compiled.py")
exec(compile(source, module.__file__, "exec"), module.__dict__)
kernel = module.kernel
"""
ELEMENT = "from stored import kernel\n\n@kernel\ndef element(x):\n    return {factor} * x\n"
CALLER = (
    "from stored import kernel\nfrom stored.element import element\n\n@kernel\ndef caller(x):\n    return element(x)\n"
)
RUN = "from stored.caller import caller; print(caller(2.0), sum(caller.stats.cache_hits.values()))"


def run(folder: Path) -> list[str]:
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(folder)!r}); {RUN}"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


@pytest.fixture
def stored(tmp_path):
    """The folder of a package whose kernels have been compiled and stored, with a factor of 3."""
    package = tmp_path / "stored"
    package.mkdir()
    (package / "__init__.py").write_text(PACKAGE)
    (package / "caller.py").write_text(CALLER)
    (package / "element.py").write_text(ELEMENT.format(factor=3.0))
    assert run(tmp_path) == ["6.0", "0"]
    return package


def test_a_changed_formula_reaches_its_callers(stored):
    assert run(stored.parent) == ["6.0", "1"]
    (stored / "element.py").write_text(ELEMENT.format(factor=5.0))
    assert run(stored.parent) == ["10.0", "0"]


def test_what_an_older_version_stored_is_not_read(stored):
    for index in (stored / "__pycache__").glob("*.nbi"):
        index.write_bytes(b"cstored.gone\nGone\n.")  # a pickle of a type of a module that is not there any more
    (stored / "element.py").write_text(ELEMENT.format(factor=5.0))
    assert run(stored.parent) == ["10.0", "0"]
