"""Builds the engine when the package is: for this processor in a clone, for all of its system in a wheel."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

TAGS = {
    "linux-x86_64": "manylinux2014_x86_64",
    "linux-aarch64": "manylinux2014_aarch64",
    "macos-arm64": "macosx_11_0_arm64",
    "windows-x86_64": "win_amd64",
}


class EngineHook(BuildHookInterface):
    """The build hook that compiles the engine before the files of a wheel are collected: for this processor in an
    editable install, else for all processors of the system ``DRAPE_SYSTEM``, by default this machine's.

    With ``DRAPE_ENGINE=apart`` it compiles nothing, since something else builds the engine.
    """

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if self.target_name != "wheel" or os.environ.get("DRAPE_ENGINE") == "apart":
            return
        path = Path(self.root) / "drape" / "engine" / "build.py"
        spec = importlib.util.spec_from_file_location("engine_build", path)
        assert spec is not None and spec.loader is not None
        engine = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(engine)
        if version == "editable":
            engine.build_here()
            return
        system = os.environ.get("DRAPE_SYSTEM") or engine.host()
        folder = Path(self.root) / "build" / "engine" / system
        engine.build_system(system, folder)
        build_data["pure_python"], build_data["tag"] = False, f"py3-none-{TAGS[system]}"
        build_data["force_include"] |= {
            str(file): f"drape/engine/libraries/{file.name}"
            for file in folder.iterdir()
            if file.suffix not in (".o", ".sources")
        }
