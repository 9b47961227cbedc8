"""``python -m drape.engine.build`` compiles the engine for this processor; ``--all`` for every target of a wheel.

The compiler is Clang out of the wheel ``ziglang``, so that no compiler of the system is needed. It is installed once
into a cache folder (``DRAPE_CACHE``, ``~/.cache/drape``), 380 MB there, and is no part of the environment. It remembers
what it has compiled: one changed file takes seconds. This file needs nothing but the standard library.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import platform
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
SOURCE, LIBRARIES = HERE / "source", HERE / "libraries"
COMPILER = "ziglang==0.15.2"
FLAGS = ["-O3", "-std=c++20", "-ffp-contract=on", "-fno-math-errno", "-fno-exceptions", "-fno-rtti", "-fPIC"]
WARNINGS = ["-Wall", "-Wextra", "-Wno-psabi"]
LINKED = ["-shared", "-nostdlib++", "-s"]
# Addresses, and what C++ leaves undefined, are checked; gcc's libasan and libubsan, preloaded, tell what is wrong.
SANITIZED = ["-O1", "-g", "-fno-omit-frame-pointer", "-fsanitize=address", "-fsanitize=undefined"]
UNITS = ("folds", "layers", "network", "physics", "setup", "swing")
TESTED = (*UNITS, "laws", "laws_swing")  # of the library that only tests load: kernels in float64, and parts of kernels


class Target(NamedTuple):
    """A processor and system: the ``name`` of the library's file, the compiler's ``triple`` and ``processor``."""

    name: str
    triple: str
    processor: str

    @property
    def suffix(self) -> str:
        """The end of a library's name on that system."""
        return ".dll" if "windows" in self.triple else ".dylib" if "macos" in self.triple else ".so"


# glibc 2.17 is that of manylinux2014: the engine takes memcpy and memset from it and nothing else.
LINUX, ARM = "x86_64-linux-gnu.2.17", "aarch64-linux-gnu.2.17"
TARGETS = {
    "linux-x86_64": [Target(f"engine-x86-64-v{level}", LINUX, f"x86_64_v{level}") for level in (2, 3, 4)],
    "linux-aarch64": [Target("engine-arm64", ARM, "generic")],
    "macos-arm64": [Target("engine-arm64", "aarch64-macos", "apple_m1")],
    "windows-x86_64": [
        Target(f"engine-x86-64-v{level}", "x86_64-windows-gnu", f"x86_64_v{level}") for level in (2, 3, 4)
    ],
}


def cache_folder() -> Path:
    """Where the compiler and what it has compiled are kept."""
    return Path(os.environ.get("DRAPE_CACHE", Path.home() / ".cache" / "drape"))


def compiler() -> list[str]:
    """The command of the compiler, which is installed the first time: a download of 93 MB."""
    try:
        import ziglang  # type: ignore[import-not-found]  # in the environment of a wheel's build

        del ziglang
        return [sys.executable, "-m", "ziglang"]
    except ImportError:
        pass
    folder = cache_folder() / COMPILER.replace("==", "-")
    if not (folder / "ziglang").is_dir():
        print(f"engine: fetching the compiler into {folder}", flush=True)
        pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input", "install", "--quiet"]
        subprocess.run([*pip, "--target", str(folder), COMPILER], check=True)
    return [str(folder / "ziglang" / ("zig.exe" if os.name == "nt" else "zig"))]


def host() -> str:
    """The name of this machine's system in ``TARGETS``."""
    system = {"Darwin": "macos"}.get(platform.system(), platform.system().lower())
    machine = {"AMD64": "x86_64"}.get(platform.machine(), platform.machine())
    return f"{system}-{machine}"


def build(
    target: Target, folder: Path, *, tests: bool = False, sanitize: bool = False, jobs: int = os.cpu_count() or 1
) -> Path:
    """Compiles the library of ``target`` into ``folder``, or the one with what only ``tests`` call; where asked to
    ``sanitize``, with checks of its memory."""
    zig, begin = compiler(), time.monotonic()
    folder.mkdir(parents=True, exist_ok=True)
    environment = os.environ | {
        f"ZIG_{kind}_CACHE_DIR": str(cache_folder() / "compiled") for kind in ("GLOBAL", "LOCAL")
    }
    common = [
        *FLAGS,
        *WARNINGS,
        *(SANITIZED if sanitize else []),
        *(["-DFOR_TESTS"] if tests else []),
        "-target",
        target.triple,
        f"-mcpu={target.processor}",
    ]
    units = TESTED if tests else UNITS
    library = folder / (target.name + ("-tests" if tests else "") + target.suffix)
    objects = [library.with_suffix(f".{unit}.o") for unit in units]

    def compiled(unit: str, to: Path) -> None:
        command = [*zig, "c++", *common, "-c", str(SOURCE / f"{unit}.cpp"), "-o", str(to)]
        subprocess.run(command, check=True, env=environment)

    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(compiled, units, objects))
    subprocess.run([*zig, "c++", *common, *LINKED, *map(str, objects), "-o", str(library)], check=True, env=environment)
    for each in objects:
        each.unlink()
    print(f"engine: {library.name} in {time.monotonic() - begin:.1f} s", flush=True)
    return library


def build_probe(system: str, folder: Path) -> None:
    """Compiles the library that tells what a processor has; only processors of x86-64 differ."""
    target = TARGETS[system][0]
    plain = target._replace(name="probe", processor="baseline")
    command = [*compiler(), "c++", *FLAGS, "-target", plain.triple, f"-mcpu={plain.processor}", *LINKED]
    subprocess.run([*command, str(SOURCE / "probe.cpp"), "-o", str(folder / f"probe{plain.suffix}")], check=True)


def this_target(folder: Path) -> Target:
    """The target of this processor; its probe is compiled into ``folder``."""
    system = host()
    build_probe(system, folder)
    level = ctypes.CDLL(str(folder / f"probe{TARGETS[system][0].suffix}")).drape_processor() % 16
    if "x86_64" in system and level < 2:
        raise SystemExit("engine: expected a processor of x86-64-v2 or later; use one of 2009 or later")
    return TARGETS[system][max(level - 2, 0)]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m drape.engine.build", description=__doc__)
    parser.add_argument("--all", action="store_true", help="every target of a wheel, not this processor's alone")
    parser.add_argument("--tests", action="store_true", help="the library that only tests load as well")
    parser.add_argument("--sanitize", action="store_true", help="with checks of memory, for `make sanitize`")
    chosen = parser.parse_args()
    LIBRARIES.mkdir(exist_ok=True)
    for system, targets in (TARGETS if chosen.all else {host(): [this_target(LIBRARIES)]}).items():
        folder = LIBRARIES / system if chosen.all else LIBRARIES
        folder.mkdir(parents=True, exist_ok=True)
        if chosen.all:
            build_probe(system, folder)
        for target in targets:
            for tests in (False, True)[: 1 + chosen.tests]:
                build(target, folder, tests=tests, sanitize=chosen.sanitize)


if __name__ == "__main__":
    main()
