"""Tries @drape/client as a registry would give it: its tarball in an application of each bundler, in a real browser.

    python scripts/try_package.py [--only vite next]    # needs Node.js 20.19, npm's registry and Chromium

Each application is examples/web/shirt.js, or shirt.jsx for Next, built for production and served as files. It passes
when a T-shirt moves, its folds made by the library's worker and WebAssembly, without an error on the console.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.serving import server  # noqa: E402
from tests.clients.browser import open_page  # noqa: E402

LIBRARY, EXAMPLES = ROOT / "clients/web/lib", ROOT / "examples/web"
THREE, FRAMES = "three@0.187.0", 30
PAGE = '<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,"><title>A shirt</title><body>{}</body>'
IMPORTS = {
    "three": "./node_modules/three/build/three.module.js",
    "three/addons/": "./node_modules/three/examples/jsm/",
    "@drape/client": "./node_modules/@drape/client/dist/index.js",
}
LAYOUT = """export default function Layout({ children }) {
  const icon = <link rel="icon" href="data:," />;
  return <html lang="en"><head>{icon}</head><body style={{ margin: 0 }}>{children}</body></html>;
}
"""


def script_tag(folder: Path) -> Path:
    """The page without a bundler: its scripts are the tarball's own files."""
    words = f'<script type="importmap">{json.dumps({"imports": IMPORTS})}</script>'
    return with_page(folder, f'{words}<script type="module" src="./shirt.js"></script>')


def vite(folder: Path) -> Path:
    """The page built by Vite, without a configuration."""
    with_page(folder, '<script type="module" src="./shirt.js"></script>')
    ran(["npx", "vite", "build", "--logLevel=warn"], folder)
    return folder / "dist"


def webpack(folder: Path) -> Path:
    """The page built by webpack, without a configuration."""
    ran(["npx", "webpack", "./shirt.js", "--mode=production", "--output-path=dist"], folder)
    (folder / "dist/index.html").write_text(PAGE.format('<script src="main.js"></script>'))
    return folder / "dist"


def next_js(folder: Path) -> Path:
    """The page built by Next, exported as files."""
    (folder / "app").mkdir()
    shutil.copy(EXAMPLES / "shirt.jsx", folder / "app/page.jsx")
    (folder / "app/layout.jsx").write_text(LAYOUT)
    (folder / "next.config.mjs").write_text('export default { output: "export" };\n')
    ran(["npx", "next", "build"], folder)
    return folder / "out"


BUNDLERS = {
    "script": (script_tag, ()),
    "vite": (vite, ("vite@7",)),
    "webpack": (webpack, ("webpack@5", "webpack-cli@6")),
    "next": (next_js, ("next@15", "react@19", "react-dom@19", "@react-three/fiber@9")),
}


def with_page(folder: Path, scripts: str) -> Path:
    """``folder``, with an index that has ``scripts``."""
    (folder / "index.html").write_text(PAGE.format(scripts))
    return folder


def ran(words: list[str], folder: Path) -> str:
    """What a command prints; it must succeed."""
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}\n{done.stdout[-3000:]}{done.stderr[-3000:]}")
    return done.stdout


class Files(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        """Says nothing."""


@contextmanager
def served(folder: list[Path]) -> Iterator[str]:
    """The origin of a server of the files in the last of ``folder``."""

    class Latest(Files):
        def __init__(self, *asked: object, **named: object) -> None:
            super().__init__(*asked, directory=str(folder[-1]), **named)  # pyright: ignore[reportArgumentType]

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Latest)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()


def moves(address: str) -> int:
    """Frames that a page at ``address`` has shown when its picture has moved; asserts that it does."""
    with open_page(address) as page:
        page.wait_for(f"Number(document.body?.dataset.frames) >= {FRAMES}")
        page.wait_until_it_moves(page.picture())
        assert page.errors == [], page.errors
        return int(page.evaluate("Number(document.body.dataset.frames)"))


def main() -> None:
    """Command line entry."""
    parser = argparse.ArgumentParser(description="Tries the tarball of @drape/client in bundlers and a browser.")
    parser.add_argument("--only", nargs="+", choices=list(BUNDLERS), default=list(BUNDLERS))
    asked = parser.parse_args().only
    folders: list[Path] = [ROOT]
    with tempfile.TemporaryDirectory(prefix="drape-package-") as place, served(folders) as origin:
        tarball = (
            Path(place) / ran(["npm", "pack", "--silent", "--pack-destination", place, str(LIBRARY)], ROOT).strip()
        )
        print(f"{tarball.name}: {tarball.stat().st_size / 1000:.0f} kB", flush=True)
        with server(allowed_origins=json.dumps([origin])) as at:
            for name in asked:
                build, packages = BUNDLERS[name]
                folder = Path(place) / name
                folder.mkdir()
                (folder / "package.json").write_text('{"private": true, "type": "module"}')
                shutil.copy(EXAMPLES / "shirt.js", folder)
                quiet = ["--no-audit", "--no-fund", "--silent", "--ignore-scripts"]
                ran(["npm", "install", *quiet, str(tarball), THREE, *packages], folder)
                folders.append(build(folder))
                print(f"{name}: {moves(f'{origin}/?service={at.url}')} frames", flush=True)


if __name__ == "__main__":
    main()
