"""Blender's add-on without Blender: its modules that do not import ``bpy``, and its zip."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path
from types import ModuleType

from tests.architecture.repository import ROOT

ADDON = ROOT / "clients/blender/addon"
NAME = "drape_addon"  # as Blender gives it a name of its own


def addon_module(name: str) -> ModuleType:
    """The module ``name`` of the add-on."""
    package = ModuleType(NAME)
    package.__path__ = [str(ADDON)]  # and not its own __init__, which needs Blender
    sys.modules.setdefault(NAME, package)
    return importlib.import_module(f"{NAME}.{name}")


def addon_zip(folder: Path) -> Path:
    """The zip of the add-on, written into ``folder`` by the repository's script."""
    said = subprocess.run([sys.executable, ROOT / "scripts/build_addon", folder], capture_output=True, check=True)
    return Path(said.stdout.decode().strip())
