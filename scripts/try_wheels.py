"""``python scripts/try_wheels.py`` installs this system's wheels of dist/ and starts the service from them.

The environment is empty and read-only, the service offline, its user without a home, no compiler is on the PATH, and
each ``DRAPE_ISA`` that this processor takes has its turn.

It says how long a start takes and how large the environment is, and writes dist/sbom.cdx.json, the packages of that
environment. Of other systems' wheels it compares tags and the functions that their engines export. A failure ends it
with the assertion that did not hold.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from asking import answer, drape  # noqa: E402

from drape.engine.build import TARGETS, host  # noqa: E402
from hatch_build import TAGS  # noqa: E402
from tests.drape.engine.symbols import exported  # noqa: E402

DIST = ROOT / "dist"
WHEEL_LIMIT, INSTALLED_LIMIT = 25e6, 400e6  # bytes
PORT = 8448
# A network that leads nowhere, and $1, the environment, read-only: for root alone.
APART = 'ip link set lo up && mount --bind "$1" "$1" && mount -o remount,bind,ro "$1" && shift && exec "$@"'


def wheel(name: str, tag: str = "any") -> Path:
    """Returns the path of the one wheel in dist/ of the distribution ``name`` for the platform ``tag``."""
    (path,) = DIST.glob(f"{name}-*-py3-none-{tag}.whl")
    return path


def look_into(system: str) -> set[str]:
    """Asserts that the core's wheel for ``system`` has its size, tag and folders, and that its engines export the same
    functions. Returns the names of these."""
    path = wheel("patchdrape", TAGS[system])
    assert path.stat().st_size <= WHEEL_LIMIT, f"{path.name}: {path.stat().st_size / 1e6:.1f} MB"
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        assert {name.split("/")[0].partition("-")[0] for name in names} == {"drape", "patchdrape"}, path.name
        assert f"Tag: py3-none-{TAGS[system]}" in archive.read(next(n for n in names if n.endswith("/WHEEL"))).decode()
        files = [f"drape/engine/libraries/{target.name}{target.suffix}" for target in TARGETS[system]]
        of_target = [{name for name in exported(archive.read(file)) if "drape" in name} for file in files]
    assert all(functions == of_target[0] for functions in of_target), system
    print(f"wheels: {path.name}, {path.stat().st_size / 1e6:.1f} MB")
    return of_target[0]


def make_environment(folder: Path) -> Path:
    """Makes a virtual environment in ``folder`` with this system's wheels of core and service, and writes its bill of
    materials to dist/. Returns the path of its interpreter."""
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    python = folder / "bin" / "python"
    core, service = wheel("patchdrape", TAGS[host()]), wheel("patchdrape_service")
    pip = [str(python), "-m", "pip", "--disable-pip-version-check", "--no-input", "install", "--quiet"]
    begin = time.monotonic()
    # The files and not their names, which others could take on an index.
    subprocess.run([*pip, f"{core}[serve]", str(service)], check=True)
    print(f"wheels: installed in {time.monotonic() - begin:.1f} s")
    bill = [sys.executable, "-m", "cyclonedx_py", "environment", "--output-file", str(DIST / "sbom.cdx.json")]
    subprocess.run([*bill, str(python)], check=True)
    return python


def size_of(python: Path) -> int:
    """Returns the bytes of the packages in the environment of the interpreter ``python``, without pip itself."""
    packages = next((python.parents[1] / "lib").glob("python*/site-packages"))
    own = ("pip", "setuptools", "pkg_resources", "_distutils_hack")
    ours = [path for path in packages.iterdir() if not path.name.startswith(own)]
    return sum(file.stat().st_size for path in ours for file in (path, *path.rglob("*")) if file.is_file())


def isas(python: Path) -> list[str]:
    """Returns the values that ``DRAPE_ISA`` may have on this processor, the oldest first: "v2" and up. Only an empty
    text where processors have no such levels."""
    code = "from drape.engine.probe import processor_level; print(processor_level()[0])"
    run = subprocess.run([str(python), "-c", code], cwd="/", capture_output=True, text=True, check=True)
    return [f"v{level}" for level in range(2, int(run.stdout) + 1)] or [""]


def serve(python: Path, isa: str) -> None:
    """Asserts that the service, run by ``python`` with the engine for ``isa``, starts within a minute, has the page and
    drapes a pose. Prints how long the start takes [s]."""
    with tempfile.TemporaryDirectory() as empty:
        environment = {"PATH": empty, "HOME": "/proc/none", "DRAPE_ISA": isa}
        command, begin = [str(python), "-m", "service", "--port", str(PORT)], time.monotonic()
        with subprocess.Popen(command, env=environment, cwd=empty, stdout=subprocess.DEVNULL) as service:
            try:
                while not answer(PORT, "/readyz"):
                    assert service.poll() is None, f"the service ended with {service.returncode}"
                    assert time.monotonic() - begin < 60.0, "no readiness in a minute"
                    time.sleep(0.01)
                ready_s = time.monotonic() - begin
                vertices = drape(PORT)
            finally:
                service.terminate()
    print(f"wheels: DRAPE_ISA={isa}: ready after {ready_s:.1f} s, {vertices} vertices", flush=True)


def main() -> None:
    """Tries the wheels of dist/, or with ``--serve`` only the starts of an environment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--serve", type=Path, metavar="PYTHON", help="only the starts, in this environment")
    python = parser.parse_args().serve
    if python:
        for isa in isas(python):
            serve(python, isa)
        return
    functions = {system: look_into(system) for system in TARGETS}
    assert len(set(map(frozenset, functions.values()))) == 1, "every system has the same functions"
    with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:
        python = make_environment(Path(folder) / "venv")
        size = size_of(python)
        print(f"wheels: {size / 1e6:.0f} MB installed with [serve]")
        assert size <= INSTALLED_LIMIT
        apart = ["unshare", "--net", "--mount", "sh", "-c", APART, "sh", str(python.parents[1])]
        if os.getuid() != 0:
            print("wheels: only root can take the network away and make the environment read-only")
            apart = []
        subprocess.run([*apart, sys.executable, __file__, "--serve", str(python)], check=True)


if __name__ == "__main__":
    main()
