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
    """Writes a page without a bundler, whose scripts are the tarball's own files, to the application in ``folder``.
    Returns the folder to serve, as the builds below do."""
    words = f'<script type="importmap">{json.dumps({"imports": IMPORTS})}</script>'
    return with_page(folder, f'{words}<script type="module" src="./shirt.js"></script>')


def vite(folder: Path) -> Path:
    """Builds the application in ``folder`` by Vite without a configuration. Returns the folder to serve."""
    with_page(folder, '<script type="module" src="./shirt.js"></script>')
    run_command(["npx", "vite", "build", "--logLevel=warn"], folder)
    return folder / "dist"


def webpack(folder: Path) -> Path:
    """Builds the application in ``folder`` by webpack without a configuration. Returns the folder to serve."""
    run_command(["npx", "webpack", "./shirt.js", "--mode=production", "--output-path=dist"], folder)
    (folder / "dist/index.html").write_text(PAGE.format('<script src="main.js"></script>'))
    return folder / "dist"


def next_js(folder: Path) -> Path:
    """Builds the application in ``folder`` by Next and exports it as files. Returns the folder to serve."""
    (folder / "app").mkdir()
    shutil.copy(EXAMPLES / "shirt.jsx", folder / "app/page.jsx")
    (folder / "app/layout.jsx").write_text(LAYOUT)
    (folder / "next.config.mjs").write_text('export default { output: "export" };\n')
    run_command(["npx", "next", "build"], folder)
    return folder / "out"


BUNDLERS = {
    "script": (script_tag, ()),
    "vite": (vite, ("vite@7",)),
    "webpack": (webpack, ("webpack@5", "webpack-cli@6")),
    "next": (next_js, ("next@15", "react@19", "react-dom@19", "@react-three/fiber@9")),
}


def with_page(folder: Path, scripts: str) -> Path:
    """Writes an index.html with the tags ``scripts`` into ``folder``, and returns ``folder``."""
    (folder / "index.html").write_text(PAGE.format(scripts))
    return folder


def run_command(words: list[str], folder: Path) -> str:
    """Returns what the command ``words`` prints in ``folder``. Ends this program if it fails."""
    run = subprocess.run(words, cwd=folder, capture_output=True, text=True)
    if run.returncode:
        raise SystemExit(f"{' '.join(words)}\n{run.stdout[-3000:]}{run.stderr[-3000:]}")
    return run.stdout


@contextmanager
def serve_last(folders: list[Path]) -> Iterator[str]:
    """Serves the files of the last of ``folders`` while the block runs, which may append folders. Yields the origin."""

    class Files(SimpleHTTPRequestHandler):
        def __init__(self, *arguments: object, **named: object) -> None:
            super().__init__(*arguments, directory=str(folders[-1]), **named)  # pyright: ignore[reportArgumentType]

        def log_message(self, format: str, *args: object) -> None:
            """Logs nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Files) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()


def count_frames(address: str) -> int:
    """Asserts that the picture of the page at ``address`` moves, without an error. Returns how many frames it has shown
    by then."""
    with open_page(address) as page:
        page.wait_for(f"Number(document.body?.dataset.frames) >= {FRAMES}")
        page.wait_until_it_moves(page.picture())
        assert page.errors == [], page.errors
        return int(page.evaluate("Number(document.body.dataset.frames)"))


def main() -> None:
    """Tries the bundlers that the command line names, and prints how many frames each page has shown."""
    parser = argparse.ArgumentParser(description="Tries the tarball of @drape/client in bundlers and a browser.")
    parser.add_argument("--only", nargs="+", choices=list(BUNDLERS), default=list(BUNDLERS))
    bundlers = parser.parse_args().only
    folders: list[Path] = [ROOT]
    with tempfile.TemporaryDirectory(prefix="drape-package-") as place, serve_last(folders) as origin:
        pack = ["npm", "pack", "--silent", "--pack-destination", place, str(LIBRARY)]
        tarball = Path(place) / run_command(pack, ROOT).strip()
        print(f"{tarball.name}: {tarball.stat().st_size / 1000:.0f} kB", flush=True)
        with server(allowed_origins=json.dumps([origin])) as at:
            for name in bundlers:
                build, packages = BUNDLERS[name]
                folder = Path(place) / name
                folder.mkdir()
                (folder / "package.json").write_text('{"private": true, "type": "module"}')
                shutil.copy(EXAMPLES / "shirt.js", folder)
                quiet = ["--no-audit", "--no-fund", "--silent", "--ignore-scripts"]
                run_command(["npm", "install", *quiet, str(tarball), THREE, *packages], folder)
                folders.append(build(folder))
                print(f"{name}: {count_frames(f'{origin}/?service={at.url}')} frames", flush=True)


if __name__ == "__main__":
    main()
