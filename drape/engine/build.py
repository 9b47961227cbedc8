"""``python drape/engine/build.py`` compiles the engine for this processor; ``--all`` for every target of a wheel,
``--wasm`` for browsers.

The compiler is Clang out of the wheel ``ziglang``, so that no compiler of the system is needed. It is installed once
into a cache folder (``DRAPE_CACHE``, ``~/.cache/drape``), 380 MB there, and is no part of the environment. It remembers
what it has compiled: one changed file takes seconds. This file needs nothing but the standard library.
"""

from __future__ import annotations

import argparse
import ctypes
import hashlib
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
SOURCE, LIBRARIES = HERE / "source", HERE / "libraries"
HEADER = SOURCE / "records.hpp"
COMPILER = "ziglang==0.15.2"
FLAGS = ["-O3", "-std=c++20", "-ffp-contract=on", "-fno-math-errno", "-fno-exceptions", "-fno-rtti", "-fPIC"]
WARNINGS = ["-Wall", "-Wextra", "-Wno-psabi"]
LINKED = ["-shared", "-nostdlib++", "-s"]
# Addresses, and what C++ leaves undefined, are checked; gcc's libasan and libubsan, preloaded, tell what is wrong.
SANITIZED = ["-O1", "-g", "-fno-omit-frame-pointer", "-fsanitize=address", "-fsanitize=undefined"]
UNITS = ("folds", "frame", "layers", "network", "physics", "push", "setup", "swing")
LAWS = ("laws_folds", "laws_physics", "laws_skinning", "laws_swing")
TESTED = (*UNITS, "emulation", *LAWS)  # of the library that only tests load


class Target(NamedTuple):
    """What a library is compiled for: the ``name`` of its file without the suffix, Clang's ``triple`` of the system,
    and the ``processor`` as Clang's ``-mcpu`` names it."""

    name: str
    triple: str
    processor: str

    @property
    def suffix(self) -> str:
        """Returns the suffix of a library's file on that system, such as ".so"."""
        ends = {"windows": ".dll", "macos": ".dylib", "wasm32": ".wasm"}
        return next((end for system, end in ends.items() if system in self.triple), ".so")


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

# Browsers: what a page calls (clients/web/lib/src), in memory that the page makes.
WEB = Target("engine", "wasm32-freestanding", "generic+simd128+bulk_memory+nontrapping_fptoint+sign_ext")
WEB_UNITS = ("folds", "layers", "network", "swing")
WEB_CALLS = (
    "pose_body", "jets", "vertices", "swing", "fold", "fold_two_levels", "lift_alone", "write_grip",
    "heights", "ceiling", "press", "draw_bound",
)  # fmt: skip
WEB_LINKED = [
    "-nostdlib",
    "-s",
    "-Wl,--no-entry",
    "-Wl,--import-memory",
    "-Wl,--export=__heap_base",
    "-Wl,--export=drape_records_hash",
    *(f"-Wl,--export=drape_{name}_f32" for name in WEB_CALLS),
]


def cache_folder() -> Path:
    """Returns the folder of the compiler and of what it has compiled: ``DRAPE_CACHE``, or else ``drape`` in the user's
    caches."""
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return Path(os.environ.get("DRAPE_CACHE") or caches / "drape")


def compiler() -> list[str]:
    """Returns the first words of the compiler's command; arguments follow them. The first call installs the compiler: a
    download of 93 MB."""
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
        part = folder.with_name(f"{folder.name}.{os.getpid()}")  # another process may fetch it at the same time
        subprocess.run([*pip, "--target", str(part), COMPILER], check=True)
        try:
            part.rename(folder)
        except OSError:
            shutil.rmtree(part)
    return [str(folder / "ziglang" / ("zig.exe" if os.name == "nt" else "zig"))]


def host() -> str:
    """Returns this machine's system as ``TARGETS`` names it, such as "linux-x86_64". One that no library is made for
    gets a name that ``TARGETS`` lacks. Ends the program with a sentence on Linux with another C library than glibc."""
    if platform.system() == "Linux" and platform.libc_ver()[0] != "glibc":
        cure = "use a system with it, as Debian or Ubuntu and their images"
        raise SystemExit(f"engine: expected Linux with glibc 2.17 or later, got another C library (musl?); {cure}")
    system = {"Darwin": "macos"}.get(platform.system(), platform.system().lower())
    machine = {"AMD64": "x86_64"}.get(platform.machine(), platform.machine())
    return f"{system}-{machine}"


def build(target: Target, folder: Path, *, tests: bool = False, sanitize: bool = False) -> Path:
    """Compiles the library of ``target`` into ``folder`` and returns its path; a library that was compiled from the
    same sources in the same way is left as it is.

    ``tests``: with the functions that only tests call. ``sanitize``: with checks of memory and of what C++ leaves
    undefined. A compiler runs on each processor. Raises ``CalledProcessError`` where one fails.
    """
    library = folder / (target.name + ("-tests" if tests else "") + target.suffix)
    made_from = sources_hash(target, tests, sanitize)
    if is_made_from(library, made_from):
        return library
    folder.mkdir(parents=True, exist_ok=True)
    zig, begin = compiler(), time.monotonic()
    units, linked = (WEB_UNITS, WEB_LINKED) if target == WEB else (TESTED if tests else UNITS, LINKED)
    environment = os.environ | {
        f"ZIG_{kind}_CACHE_DIR": str(cache_folder() / "compiled") for kind in ("GLOBAL", "LOCAL")
    }
    chosen = [*(SANITIZED if sanitize else []), *(["-DFOR_TESTS"] if tests else [])]
    common = [*FLAGS, *WARNINGS, *chosen, *_aimed(target)]
    objects = [library.with_suffix(f".{unit}.o") for unit in units]

    def compiled(unit: str, to: Path) -> None:
        command = [*zig, "c++", *common, "-c", str(SOURCE / f"{unit}.cpp"), "-o", str(to)]
        subprocess.run(command, check=True, env=environment)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(compiled, units, objects))
    linked_file = library.with_suffix(".new")  # moved into place whole: another process may have the old one open
    command = [*zig, "c++", *common, *linked, *map(str, objects), "-o", str(linked_file)]
    subprocess.run(command, check=True, env=environment)
    linked_file.replace(library)
    _hash_file(library).write_text(made_from)
    for path in objects:
        path.unlink()
    print(f"engine: {library.name} in {time.monotonic() - begin:.1f} s", flush=True)
    return library


def build_probe(system: str, folder: Path) -> Path:
    """Compiles ``probe.cpp`` for ``system``, a key of ``TARGETS``, into ``folder`` and returns the library's path. It
    tells the level of an x86-64 processor, and runs on the oldest one."""
    target = TARGETS[system][0]._replace(name="probe", processor="baseline")
    probe, made_from = folder / f"probe{target.suffix}", sources_hash(target)
    if not is_made_from(probe, made_from):
        command = [*compiler(), "c++", *FLAGS, *_aimed(target), *LINKED, str(SOURCE / "probe.cpp"), "-o", str(probe)]
        subprocess.run(command, check=True)
        _hash_file(probe).write_text(made_from)
    return probe


def build_here(*, tests: bool = False, sanitize: bool = False) -> None:
    """Compiles the library for this processor into ``LIBRARIES``, or for the lower level that ``DRAPE_ISA`` names.

    ``tests``: also the library that only tests load. ``sanitize``: as for ``build``. Ends the program with a sentence
    where the processor or the C library is too old.
    """
    LIBRARIES.mkdir(parents=True, exist_ok=True)
    level = ctypes.CDLL(str(build_probe(host(), LIBRARIES))).drape_processor() % 16
    if "x86_64" in host() and level < 2:
        raise SystemExit(f"engine: expected a processor of x86-64-v2 or later, got v{level}; use one of 2009 or later")
    forced = os.environ.get("DRAPE_ISA", "")
    named = [target for target in TARGETS[host()] if forced and target.name.endswith(f"-{forced}")]
    target = named[0] if named else TARGETS[host()][max(level - 2, 0)]
    for what in (False, True)[: 1 + tests]:
        build(target, LIBRARIES, tests=what, sanitize=sanitize)


def build_system(system: str, folder: Path) -> None:
    """Compiles the libraries of a wheel for ``system`` into ``folder``: the probe, and one for each level of
    processors."""
    folder.mkdir(parents=True, exist_ok=True)
    build_probe(system, folder)
    for target in TARGETS[system]:
        build(target, folder)


def _aimed(target: Target) -> list[str]:
    return ["-target", target.triple, f"-mcpu={target.processor}", *(["-fno-PIC"] if target == WEB else [])]


def write_header() -> None:
    """Writes ``source/records.hpp`` from the table in ``records.py``, unless the file is there and was written from the
    same table."""
    spec = importlib.util.spec_from_file_location("engine_records", HERE / "records.py")
    assert spec is not None and spec.loader is not None
    records = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(records)
    text = records.header()
    if not HEADER.is_file() or HEADER.read_text() != text:
        part = HEADER.with_suffix(f".{os.getpid()}")  # another process may compile at the same time
        part.write_text(text)
        part.replace(HEADER)


def sources_hash(target: Target, tests: bool = False, sanitize: bool = False) -> str:
    """Returns the SHA-256, in hexadecimal digits, of all that decides what a library of ``target`` is: the sources,
    this file, the target and the two flags. Writes the header of records first."""
    write_header()
    digest = hashlib.sha256(repr((target, tests, sanitize)).encode())
    for source in (*sorted(SOURCE.glob("*.[ch]*")), Path(__file__)):
        digest.update(source.name.encode() + source.read_bytes())
    return digest.hexdigest()


def is_made_from(library: Path, sources: str) -> bool:
    """Returns whether ``library`` exists and was compiled from sources whose ``sources_hash`` is ``sources``."""
    hash_file = _hash_file(library)
    return library.is_file() and hash_file.is_file() and hash_file.read_text() == sources


def _hash_file(library: Path) -> Path:
    """The file beside ``library`` that has the hash of its sources. Times say less: a checkout changes them."""
    return library.with_name(f"{library.name}.sources")


def main() -> None:
    """Compiles what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tests", action="store_true", help="the library that only tests load as well")
    parser.add_argument("--system", action="store_true", help="every level of processors of this system")
    parser.add_argument("--wasm", action="store_true", help="for browsers, and nothing else")
    parser.add_argument("--all", action="store_true", help="every system, each in a folder of its own")
    parser.add_argument("--sanitize", action="store_true", help="with checks of memory, for `make sanitize`")
    chosen = parser.parse_args()
    if chosen.wasm:
        build(WEB, LIBRARIES)
    elif chosen.all:
        for system in TARGETS:
            build_system(system, LIBRARIES / system)
    elif chosen.system:
        build_system(host(), LIBRARIES)
    else:
        build_here(tests=chosen.tests, sanitize=chosen.sanitize)


if __name__ == "__main__":
    main()
