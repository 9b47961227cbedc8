"""``python scripts/try_wheels.py`` installs this system's wheels of dist/ and starts the service from them.

The environment is empty, the service offline, its user may write nowhere, no compiler is on the PATH, and each
``DRAPE_ISA`` has its turn.

It says how long a start takes and how large the environment is, and writes dist/sbom.cdx.json, the packages of that
environment. Of other systems' wheels it compares tags and the functions that their engines export. A failure ends it
with the assertion that did not hold.
"""

from __future__ import annotations

import argparse
import array
import json
import math
import os
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from drape.engine.build import TARGETS, host  # noqa: E402
from hatch_build import TAGS  # noqa: E402
from tests.drape.engine.symbols import exported  # noqa: E402

DIST = ROOT / "dist"
WHEEL_LIMIT, INSTALLED_LIMIT, READY_LIMIT_S = 25e6, 400e6, 3.0
PORT = 8448
NOBODY = 65534
# A network of its own, which leads nowhere.
OFFLINE = ["unshare", "--net", "sh", "-c", 'ip link set lo up && exec "$0" "$@"']
ISAS = [target.name.rpartition("-")[2] for target in TARGETS[host()]] if "x86_64" in host() else [""]
ASKED = {"garment": "tshirt", "poses": [[[0.0, 0.0, 0.0]] * 24]}


def wheel(name: str, tag: str = "any") -> Path:
    """The one wheel of a member in dist/, that for the system of a ``tag``."""
    (found,) = DIST.glob(f"{name}-*-py3-none-{tag}.whl")
    return found


def look_into(system: str) -> set[str]:
    """The functions that the engines in the wheel for ``system`` export, after a look at its tag, size and files."""
    path = wheel("patchdrape", TAGS[system])
    assert path.stat().st_size <= WHEEL_LIMIT, f"{path.name}: {path.stat().st_size / 1e6:.1f} MB"
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        assert {name.split("/")[0].partition("-")[0] for name in names} == {"drape", "patchdrape"}, path.name
        assert f"Tag: py3-none-{TAGS[system]}" in archive.read(next(n for n in names if n.endswith("/WHEEL"))).decode()
        files = [f"drape/engine/libraries/{target.name}{target.suffix}" for target in TARGETS[system]]
        of_target = [{one for one in exported(archive.read(file)) if "drape" in one} for file in files]
    assert all(one == of_target[0] for one in of_target), system
    print(f"wheels: {path.name}, {path.stat().st_size / 1e6:.1f} MB")
    return of_target[0]


def installed(folder: Path) -> Path:
    """The interpreter of a new environment in ``folder`` with this system's wheels of core and service."""
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
    """Bytes of what pip has installed, without pip and what it has compiled."""
    packages = next((python.parents[1] / "lib").glob("python*/site-packages"))
    files = [path for path in packages.rglob("*") if path.is_file() and not path.is_symlink()]
    own = ("pip", "setuptools", "pkg_resources", "_distutils_hack")
    return sum(
        path.stat().st_size
        for path in files
        if path.suffix != ".pyc" and not path.relative_to(packages).parts[0].startswith(own)
    )


def serve(python: Path, isa: str) -> None:
    """Starts the service with the engine for ``isa``, and says in how many seconds it was ready; then it must drape a
    pose and show its page."""
    as_nobody = {"user": NOBODY, "group": NOBODY, "extra_groups": []} if os.getuid() == 0 else {}
    with tempfile.TemporaryDirectory() as empty:
        os.chmod(empty, 0o555)
        environment = {"PATH": empty, "HOME": "/nonexistent", "DRAPE_ISA": isa}
        command, begin = [str(python), "-m", "service", "--port", str(PORT)], time.monotonic()
        with subprocess.Popen(command, env=environment, cwd=empty, stdout=subprocess.DEVNULL, **as_nobody) as service:
            try:
                while not answer("/readyz"):
                    assert service.poll() is None, f"the service ended with {service.returncode}"
                    assert time.monotonic() - begin < 60.0, "no readiness in a minute"
                    time.sleep(0.01)
                ready_s = time.monotonic() - begin
                assert b"<script" in answer("/"), "the page"
                places = array.array("f", answer("/drape", json.dumps(ASKED).encode()))
                assert len(places) > 3000 and all(map(math.isfinite, places)), "a draped shirt"
            finally:
                service.terminate()
    assert ready_s <= READY_LIMIT_S, f"ready after {ready_s:.1f} s"
    print(f"wheels: DRAPE_ISA={isa}: ready after {ready_s:.2f} s, {len(places) // 3} vertices", flush=True)


def answer(path: str, body: bytes | None = None) -> bytes:
    """What the service answers, nothing while it does not listen or is not ready."""
    request = urllib.request.Request(f"http://127.0.0.1:{PORT}{path}", body, {"Content-Type": "application/json"})
    try:
        with urllib.request.urlopen(request, timeout=30) as found:
            return found.read()
    except urllib.error.HTTPError as error:
        if error.code != 503:
            raise
    except OSError:
        pass
    return b""


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--serve", type=Path, metavar="PYTHON", help="only the starts, in this environment")
    python = parser.parse_args().serve
    if python:
        for isa in ISAS:
            serve(python, isa)
        return
    functions = {system: look_into(system) for system in TARGETS}
    assert len(set(map(frozenset, functions.values()))) == 1, "every system has the same functions"
    with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:
        os.chmod(folder, 0o755)
        python = installed(Path(folder) / "venv")
        size = size_of(python)
        print(f"wheels: {size / 1e6:.0f} MB installed with [serve]")
        assert size <= INSTALLED_LIMIT
        # Root may write anywhere, so that the service runs as nobody, whose all this is not.
        offline = OFFLINE if os.getuid() == 0 else []
        print("wheels: " + ("offline, as nobody" if offline else "not as root: not offline, and files may be written"))
        subprocess.run([*offline, sys.executable, __file__, "--serve", str(python)], check=True)


if __name__ == "__main__":
    main()
