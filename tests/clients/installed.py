"""The tarball of @drape/client in a folder of its own, as an application has it."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.architecture.repository import ROOT
from tests.clients.built import why_not_the_page

WEB = ROOT / "clients/web"
LIBRARY = WEB / "lib"
# What the application has besides, from its own registry: peers, and types of theirs.
BESIDES = ("three", "@types/three")


def run(words: list[str], folder: Path) -> str:
    """What the command prints; it must succeed."""
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def node_with_sockets() -> list[str]:
    """The command of a Node.js that has WebSocket; the test skips where there is none."""
    node = shutil.which("node")
    if node is None or shutil.which("npm") is None:
        pytest.skip("No Node.js with npm: sudo apt-get install nodejs npm.")
    command = [node, "--experimental-websocket"]
    if subprocess.run([*command, "-e", "WebSocket"], capture_output=True).returncode:
        pytest.skip("A Node.js without WebSocket: 20.10 or newer has it.")
    return command


def install(folder: Path) -> Path:
    """``folder`` with the packed library installed, without asking a registry."""
    node_with_sockets()
    if not (LIBRARY / "dist/index.js").is_file() or not (WEB / "node_modules/typescript").is_dir():
        pytest.skip("@drape/client is not built: `make page`.")
    if reason := why_not_the_page():
        pytest.fail(reason, pytrace=False)
    tarball = run(["npm", "pack", "--silent", "--pack-destination", str(folder), str(LIBRARY)], folder).strip()
    (folder / "package.json").write_text('{"type": "module", "private": true}')
    quiet = ["--offline", "--legacy-peer-deps", "--ignore-scripts", "--no-audit", "--no-fund", "--silent"]
    run(["npm", "install", *quiet, f"./{tarball}"], folder)
    for name in BESIDES:
        link = folder / "node_modules" / name
        link.parent.mkdir(exist_ok=True)
        os.symlink(WEB / "node_modules" / name, link, target_is_directory=True)
    return folder
