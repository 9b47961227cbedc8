"""The page by Lighthouse: its scores, what it loads until a shirt moves, and when that is.

    python -m benchmarks.page --save        # CHROMIUM=/path/to/chromium; npm fetches Lighthouse once
    python -m benchmarks.page --devices phone --quick

A service is started for it, and visited once before, so that its outfit is ready. Each row is one visit of a fresh
profile. ``simulated`` rows are Lighthouse's usual ones, whose times are computed of an unhindered visit; without
``webgl`` the browser refuses it and the page says so. ``applied`` rows are of a visit that is really slowed down, the
line and the processor: of these are ``moves_s``, from the beginning of the visit to the second frame of cloth, and
``moving_kb``, all bytes until then, the stream's among them. Graphics are drawn by the processor here, which costs
``blocking_s`` that a device with a graphics card does not pay.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import tempfile
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from benchmarks.harness import Benchmark, Option, Run
from benchmarks.serving import Server, server
from benchmarks.tables import Row
from drape.errors import Unavailable

LIGHTHOUSE = "lighthouse@12.8.2"
VISIT_S = 400.0
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
HEADLESS = "--headless=new --no-sandbox --disable-dev-shm-usage"
DRAWN = "--use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader"  # by the processor, wherever it runs
REFUSED = "--disable-gpu --disable-3d-apis"
CATEGORIES = {
    "performance": "performance",
    "accessibility": "accessibility",
    "best_practices": "best-practices",
    "seo": "seo",
}
SECONDS = {
    "first_paint_s": "first-contentful-paint", "largest_paint_s": "largest-contentful-paint",
    "blocking_s": "total-blocking-time", "speed_index_s": "speed-index",
}  # fmt: skip
COLUMNS = {
    "device": "s", "slowed": "s", "webgl": "s", **dict.fromkeys(CATEGORIES, "d"), **dict.fromkeys(SECONDS, ".2f"),
    "shift": ".3f", "loaded_kb": ".0f", "moves_s": ".2f", "moving_kb": ".0f",
}  # fmt: skip
MARK = "moving"  # of clients/web/src/first.js


def visited(address: str, browser: str, *, device: str, slowed: str, webgl: bool) -> Row:
    """The row of a visit at ``address``."""
    npm = shutil.which("npm")
    if npm is None:
        raise Unavailable("npm", expected="Node.js 18 or newer with npm", got="none", cure="Install nodejs and npm.")
    with tempfile.TemporaryDirectory(prefix="drape-page-") as folder:
        report = Path(folder) / "page.json"
        flags = f"{HEADLESS} {DRAWN if webgl else REFUSED}"
        words = [
            npm,
            "exec",
            "--yes",
            f"--package={LIGHTHOUSE}",
            "--",
            "lighthouse",
            address,
            "--quiet",
            "--output=json",
        ]
        words += [f"--output-path={report}", f"--chrome-flags={flags}", "--save-assets"]
        words += ["--preset=desktop"] if device == "desktop" else []
        words += ["--throttling-method=devtools"] if slowed == "applied" else []
        run = subprocess.run(
            words, capture_output=True, text=True, timeout=VISIT_S, env=os.environ | {"CHROME_PATH": browser}
        )
        if not report.is_file():
            raise Unavailable(
                "lighthouse", expected="a report", got=run.stderr[-300:], cure="Is npm's registry reached?"
            )
        said = json.loads(report.read_text())
        row: Row = {"device": device, "slowed": slowed, "webgl": "with" if webgl else "without"} | scored(said)
        assets = [json.loads((Path(folder) / f"page-0.{kind}.json").read_text()) for kind in ("trace", "devtoolslog")]
        return row | (moved(assets[0]["traceEvents"], assets[1]) if webgl else {})


def scored(report: dict[str, Any]) -> Row:
    """Scores to 100, times [s] and bytes [kB] of Lighthouse's ``report``; without those that it could not tell, as of a
    page that is never idle."""
    audits, scores = report["audits"], report["categories"]
    told = {name: scores[one]["score"] for name, one in CATEGORIES.items() if one in scores}
    row: Row = {name: round(100 * score) for name, score in told.items() if score is not None}
    times = {name: audits[one].get("numericValue") for name, one in SECONDS.items()}
    row |= {name: time_ms / 1000.0 for name, time_ms in times.items() if time_ms is not None}
    row["shift"] = audits["cumulative-layout-shift"]["numericValue"]
    row["loaded_kb"] = audits["total-byte-weight"]["numericValue"] / 1000.0
    return row


def moved(trace: list[dict[str, Any]], log: list[dict[str, Any]]) -> Row:
    """When cloth moves, from the beginning of the visit of the page, and the bytes that have come until then; nothing
    where the visit ended before."""
    marks = [event for event in trace if event["name"] == MARK and "blink.user_timing" in event["cat"]]
    if not marks:
        return {}
    moving_us = marks[-1]["ts"]
    visits = [event for event in trace if event["name"] == "navigationStart" and event["ts"] < moving_us]
    begun_us = max(event["ts"] for event in visits if event["args"]["data"]["documentLoaderURL"])  # frames have none
    count = 0.0
    for event in log:
        method, told = event["method"], event["params"]
        if not begun_us <= 1e6 * told.get("timestamp", 0.0) <= moving_us:
            continue
        if method == "Network.loadingFinished":
            count += told["encodedDataLength"]
        elif method == "Network.webSocketFrameReceived":
            payload = told["response"]["payloadData"]
            count += len(base64.b64decode(payload) if told["response"]["opcode"] == 2 else payload.encode())
    return {"moves_s": (moving_us - begun_us) / 1e6, "moving_kb": count / 1000.0}


@Benchmark(
    "page_lighthouse",
    "The page by Lighthouse.",
    COLUMNS,
    Option("--devices", ("phone", "desktop"), "as Lighthouse has them", ("phone",), choices=("phone", "desktop")),
    Option("--slowed", ("simulated", "applied"), "how the visit is slowed down", ("simulated",)),
    Option("--url", "", "of a service that runs already"),
)
def main(run: Run) -> None:
    """A row for each device and way to slow a visit down, with WebGL, and simulated without."""
    options = run.options
    browser = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise Unavailable("browser", expected="a Chromium", got="none", cure="Install chromium, or set CHROMIUM.")
    with nullcontext(Server(options.url.rstrip("/"), 0)) if options.url else server() as at:
        address = at.url
        visited(
            address, browser, device="phone", slowed="simulated", webgl=True
        )  # who comes first waits for the outfit
        for device in options.devices:
            for slowed in options.slowed:
                run.add([visited(address, browser, device=device, slowed=slowed, webgl=True)])
            if not options.quick:
                run.add([visited(address, browser, device=device, slowed="simulated", webgl=False)])


if __name__ == "__main__":
    main.command()
