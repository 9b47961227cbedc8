"""``python scripts/release.py`` fills dist/ with the Python packages of a release.

A member is a folder with a pyproject.toml of its own. Each has an sdist and a wheel; the core has a wheel for every
system. ``--image`` makes only what an image of this system takes: the core's wheel for it, and the service's. The page
must have been built (``make page``).

The wheels of other systems come from the same compiler; ``scripts/try_wheels.py`` installs this system's and looks into
the others.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from drape.engine.build import LIBRARIES, TARGETS, WEB, host  # noqa: E402

DIST = ROOT / "dist"
MEMBERS = ("service", "clients", "recovery", "training", "model_export")
PAGES = ROOT / "service" / "pages"


def build_member(folder: str, *arguments: str, system: str = "") -> None:
    """Writes the sdist and the wheel of the package in ``folder`` to dist/. ``arguments``, such as ``--wheel`` for
    the wheel alone, go to ``python -m build``. The engine in the core's wheel is that for ``system``."""
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(DIST), *arguments, folder]
    subprocess.run(command, cwd=ROOT, env=os.environ | {"DRAPE_SYSTEM": system}, check=True, stdout=subprocess.DEVNULL)


def put_pages() -> None:
    """Copies the built pages and the engine for browsers into the package of the service."""
    shutil.rmtree(PAGES, ignore_errors=True)
    for page in ("dist", "static/dist"):
        ignored = shutil.ignore_patterns(".stamp")
        shutil.copytree(ROOT / "clients" / "web" / page, PAGES / page, ignore=ignored)
    shutil.copy(LIBRARIES / f"{WEB.name}{WEB.suffix}", PAGES)


def pack_members(members: tuple[str, ...]) -> None:
    """Writes the sdists and wheels of ``members``, which are folders other than the core, to dist/: each with the
    licence, the service with its pages too."""
    licences = [ROOT / member / "LICENSE" for member in members]
    try:
        put_pages()
        for member, licence in zip(members, licences, strict=True):
            shutil.copy(ROOT / "LICENSE", licence)
            build_member(member)  # the wheel comes from the sdist, so that this one is whole
            print(f"release: {member}", flush=True)
    finally:
        shutil.rmtree(PAGES, ignore_errors=True)
        for licence in licences:
            licence.unlink(missing_ok=True)


def main() -> None:
    """Empties dist/ and writes the packages that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--image", action="store_true", help="only the wheels that an image of this system takes")
    for_image = parser.parse_args().image
    shutil.rmtree(DIST, ignore_errors=True)
    pack_members(("service",) if for_image else MEMBERS)
    if not for_image:
        build_member(".", "--sdist")
    for system in [host()] if for_image else TARGETS:
        build_member(".", "--wheel", system=system)
        print(f"release: drape for {system}", flush=True)


if __name__ == "__main__":
    main()
