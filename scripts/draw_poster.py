"""Draws clients/web/src/poster.webp: the person of the page in the first pose, which is shown until cloth moves.

python scripts/draw_poster.py http://127.0.0.1:8000    # of a running service
"""

from __future__ import annotations

import base64
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.clients.browser import open_page  # noqa: E402

TARGET = ROOT / "clients/web/src/poster.webp"
QUALITY = 78  # of WebP
FRAMES = 90  # until folds have come to rest
# Where the page puts the person, as makeRoom() of main.js and fit() of stage.js have it; leaves nothing but the person.
PLACE = """(() => {
  const bottom = innerHeight - document.getElementById("dock").getBoundingClientRect().top + 12;
  const [top, width] = [40, document.getElementById("shelf").getBoundingClientRect().left];
  for (const it of document.querySelectorAll("#head, #tools, #dock, #notes, #shelf")) it.style.visibility = "hidden";
  document.documentElement.style.background = document.body.style.background = "none";
  const height = innerHeight - top - bottom;
  const side = (1.2 / (1.09 * 1.83)) * height; // as wide as 1.2 m, as high as 1.09 of 1.83 m
  return { x: Math.round((width - side) / 2), y: top, width: Math.round(side), height: Math.round(height), scale: 1 };
})()"""


def main(service: str) -> None:
    """Writes the picture of the page of the service at the address ``service`` to ``TARGET``."""
    with open_page("about:blank") as page:
        page.call("Emulation.setDeviceMetricsOverride", width=1350, height=975, deviceScaleFactor=1, mobile=False)
        page.media(scheme="light", reduced_motion=True)
        page.go(f"{service}/?quality=high")
        page.wait_for(f"Number(document.body?.dataset.frames) >= {FRAMES}")
        clip = page.evaluate(PLACE)
        page.call("Emulation.setDefaultBackgroundColorOverride", color={"r": 0, "g": 0, "b": 0, "a": 0})
        picture = page.call("Page.captureScreenshot", format="webp", quality=QUALITY, clip=clip)
    TARGET.write_bytes(base64.b64decode(picture["data"]))
    print(f"{TARGET.relative_to(ROOT)}: {clip['width']} x {clip['height']} pixels, {TARGET.stat().st_size} bytes")


if __name__ == "__main__":
    main(sys.argv[1])
