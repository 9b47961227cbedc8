"""What the modules of @drape/client compute, in Node.js."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.architecture.repository import ROOT

READ = """
const input = JSON.parse(await new Promise((done) => {
  let text = ""; process.stdin.on("data", (part) => (text += part)).on("end", () => done(text));
}));
"""


def answer_of(script: str, document: dict[str, Any], folder: Path) -> Any:
    """What ``script`` prints, read as JSON; it runs beside the modules and finds ``document`` as ``input``."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("No Node.js: sudo apt-get install nodejs.")
    for source in (ROOT / "clients/web/lib/src").glob("*.js"):
        shutil.copy(source, folder)
    (folder / "package.json").write_text('{"type": "module"}')
    (folder / "asked.js").write_text(READ + script)
    words = [node, str(folder / "asked.js")]
    run = subprocess.run(words, input=json.dumps(document), capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


def page_answer(script: str, document: dict[str, Any], folder: Path) -> Any:
    """Like ``answer_of`` for modules that need three.js: ``WEB`` is the address of clients/web, to import from."""
    node = shutil.which("node")
    if node is None or not (ROOT / "clients/web/node_modules/three").is_dir():
        pytest.skip("No Node.js, or no packages of the page: `make page`.")
    asked = folder / "asked.mjs"
    asked.write_text(f"const WEB = {json.dumps((ROOT / 'clients/web').as_uri())};\n{READ}{script}")
    words = [node, str(asked)]
    run = subprocess.run(words, input=json.dumps(document), capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)
