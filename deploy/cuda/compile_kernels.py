"""Compiles the kernels into the wheel of the extra ``cuda``. It needs ``nvcc`` and a clone, and no card."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

CLONE = Path(__file__).resolve().parents[2]


class KernelsHook(BuildHookInterface):
    """A build hook of hatchling that puts the compiled kernels into the wheel, as ``drape_cuda/card.fatbin``.

    Another process compiles, because the environment of the build has no package ``drape``.
    """

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        path = CLONE / "build" / "cuda" / "card.fatbin"
        script = "import sys; from pathlib import Path; from drape.engine.card import build_kernels as build; "
        command = [sys.executable, "-c", f"{script}build(Path(sys.argv[1]))", str(path)]
        subprocess.run(command, cwd=CLONE, check=True)
        build_data["force_include"] |= {str(path): f"drape_cuda/{path.name}"}
