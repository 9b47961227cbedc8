"""Drives headless Chromium over its DevTools protocol, with nothing but a WebSocket."""

from __future__ import annotations

import base64
import io
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image
from websockets.sync.client import ClientConnection, connect

from tests.architecture.repository import ROOT
from tests.conftest import find_chromium
from tests.fixtures.patience import PATIENT_S

AXE = ROOT / "clients/web/node_modules/axe-core/axe.min.js"

# Software rendering, also where there is a graphics card: the same picture everywhere.
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--no-first-run", "--disable-extensions",
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--remote-debugging-port=0",
    "--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream",
)  # fmt: skip

# What DevTools say of a call that was under way when the page changed.
LEFT = ("navigated or closed", "Cannot find context", "Execution context was destroyed")


class Gone(Exception):
    """The page was left for another while it was asked."""


class Page:
    """One open page; ``errors`` holds console errors, uncaught exceptions and failed loads so far."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self._number = 0
        self.errors: list[str] = []
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The result of a DevTools method."""
        self._number += 1
        self._connection.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._connection.recv(timeout=PATIENT_S))
            if message.get("id") == self._number:
                if "error" in message and any(words in message["error"]["message"] for words in LEFT):
                    raise Gone(message["error"]["message"])
                assert "error" not in message, message["error"]
                return message["result"]
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        parameters = message.get("params", {})
        if message["method"] == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(parameters["exceptionDetails"]))
        elif message["method"] == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.errors.append(json.dumps(parameters["entry"]))
        elif message["method"] == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "assert"):
            self.errors.append(json.dumps(parameters["args"]))

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def wait_for(self, expression: str, *, seconds: float = PATIENT_S) -> Any:
        """The value of ``expression`` once it is true, on this page or on one that comes in its place."""
        deadline = time.monotonic() + seconds
        while True:
            with suppress(Gone):
                if value := self.evaluate(expression):
                    return value
            assert time.monotonic() < deadline, (
                f"{expression}; {self.evaluate('document.body?.innerText')}; {self.errors}"
            )
            time.sleep(0.1)

    def choose_file(self, selector: str, *paths: Path) -> None:
        """Puts files into a file input."""
        document = self.call("DOM.getDocument")["root"]["nodeId"]
        node = self.call("DOM.querySelector", nodeId=document, selector=selector)["nodeId"]
        self.call("DOM.setFileInputFiles", nodeId=node, files=[str(path) for path in paths])

    def drop(self, *paths: Path) -> None:
        """Drops files and folders on the page, as the hand of a user does."""
        data = {"items": [], "files": [str(path) for path in paths], "dragOperationsMask": 1}
        for kind in ("dragEnter", "dragOver", "drop"):
            self.call("Input.dispatchDragEvent", type=kind, x=300, y=300, data=data)

    def go(self, url: str) -> None:
        """Leaves for ``url``."""
        self.call("Page.navigate", url=url)

    def phone(self, width: int, height: int) -> None:
        """Shows pages from now on as a phone of that many pixels does."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=True)
        self.call("Emulation.setTouchEmulationEnabled", enabled=True)

    def media(self, *, scheme: str, reduced_motion: bool = False) -> None:
        """What the system asks of pages: the colour scheme ``light`` or ``dark``, and less motion."""
        motion = "reduce" if reduced_motion else "no-preference"
        wanted = {"prefers-color-scheme": scheme, "prefers-reduced-motion": motion}
        self.call("Emulation.setEmulatedMedia", features=[{"name": k, "value": v} for k, v in wanted.items()])

    def picture(self) -> np.ndarray:
        """What the compositor shows, (height, width, 3) from 0 to 255."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        with Image.open(io.BytesIO(base64.b64decode(data))) as image:
            return np.asarray(image.convert("RGB")).astype(int)

    def wait_for_picture(self, shows: Callable[[np.ndarray], bool], missing: str) -> np.ndarray:
        """The first picture that ``shows`` what is waited for: on a busy machine it is behind what the page says."""
        deadline = time.monotonic() + PATIENT_S
        while not shows(picture := self.picture()):
            assert time.monotonic() < deadline, missing
            time.sleep(0.1)
        return picture

    def wait_until_it_moves(self, before: np.ndarray) -> None:
        """Waits for a picture that differs from the one ``before``."""
        self.wait_for_picture(lambda now: (np.abs(now - before).max(axis=-1) > 30).mean() > 0.001, "nothing moves")


def violations(page: Page) -> list[str]:
    """What axe-core finds in the page that keeps people out: rule, element, summary of each; skips without axe-core."""
    if not AXE.is_file():
        pytest.skip("No axe-core: `npm ci` in clients/web.")
    if not page.evaluate("typeof window.axe === 'object'"):
        page.evaluate(AXE.read_text(encoding="utf-8") + ";true")
    found = page.evaluate("axe.run(document, { resultTypes: ['violations'] }).then(({ violations }) => violations)")
    return [f"{rule['id']}: {node['html'][:120]} {node['failureSummary']}" for rule in found for node in rule["nodes"]]


@contextmanager
def open_page(url: str, *, width: int = 900, height: int = 640) -> Iterator[Page]:
    """``url`` in a fresh profile."""
    chromium = find_chromium()
    assert chromium is not None  # the marker has seen to it
    profile = Path(tempfile.mkdtemp(prefix="drape-chromium-"))
    command = [chromium, *FLAGS, f"--user-data-dir={profile}", f"--window-size={width},{height}", "about:blank"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        port = _debugging_port(profile, process)
        targets = httpx.get(f"http://127.0.0.1:{port}/json/list").json()
        address = next(target["webSocketDebuggerUrl"] for target in targets if target["type"] == "page")
        with connect(address, max_size=64 * 2**20, compression=None) as connection:
            page = Page(connection)
            page.call("Page.navigate", url=url)
            yield page
    finally:
        process.terminate()
        try:
            process.wait(timeout=2.0)  # a page that draws may not listen for ten
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        shutil.rmtree(profile, ignore_errors=True)


def _debugging_port(profile: Path, process: subprocess.Popen[bytes]) -> int:
    deadline = time.monotonic() + PATIENT_S
    file = profile / "DevToolsActivePort"
    while not (file.is_file() and (lines := file.read_text().splitlines())):
        assert process.poll() is None and time.monotonic() < deadline, "Chromium did not start"
        time.sleep(0.05)
    return int(lines[0])
