"""The files that belong to the repository, as the architecture tests read them."""

from __future__ import annotations

import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("drape", "training", "model_export", "service", "clients", "recovery", "benchmarks")
_NOT_OURS = {".git", ".venv", ".serve", "node_modules", "dist", "build", "runs", "__pycache__"}


def repository_files() -> list[Path]:
    """Every file that git tracks or would track; outside a clone, every file that is not built or installed."""
    command = ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    try:
        listed = subprocess.run(command, capture_output=True, check=True, text=True).stdout
        paths = [ROOT / name for name in listed.split("\0") if name]
    except (OSError, subprocess.CalledProcessError):  # no git, or an unpacked archive
        paths = [path for path in ROOT.rglob("*") if not _NOT_OURS & set(path.relative_to(ROOT).parts)]
    return sorted(path for path in set(paths) if path.is_file() and not path.is_symlink())


def text_files() -> list[tuple[Path, str]]:
    """Every text file of the repository with its content."""
    found = []
    for path in repository_files():
        content = path.read_bytes()
        if b"\0" in content[:8192]:
            continue
        try:
            found.append((path, content.decode("utf-8")))
        except UnicodeDecodeError:
            continue
    return found
