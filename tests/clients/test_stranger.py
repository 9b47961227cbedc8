"""A page of another origin, which has the library from its own server: a garment moves on the body there."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest

from drape.body.model import BodyModel
from drape.catalog import find_motions
from drape.motion.readers import read_motion
from service.settings import Settings
from tests.architecture.repository import ROOT
from tests.clients.browser import open_page
from tests.clients.people import person
from tests.clients.test_page import share
from tests.fixtures.serving import served

pytestmark = pytest.mark.browser

PAGE, CAMERA = "/examples/web/stranger.html", "/examples/web/camera.html"
WRITTEN = {page: (ROOT / page[1:]).read_text(encoding="utf-8") for page in (PAGE, CAMERA)}
TRACKER_PATH = "/examples/web/tracker.js"
# A tracker that sees a person squat, and nobody where it begins.
TRACKER = """export async function track(video, put) {
  if (!video.videoWidth) throw new Error("no picture");
  const points = POINTS;
  put(points[0].slice(1));
  await new Promise((done) => setTimeout(done, 500));
  document.body.dataset.told = document.querySelector("p").textContent;
  for (let n = 0; ; n++) {
    put(points[n % points.length]);
    await new Promise((done) => setTimeout(done, 30));
  }
}"""
# What is worn by a library that the page imports beside its own: with its worker, with one of the page, and without.
WORN_HERE = """(async () => {
  const { connect } = await import("/clients/web/lib/dist/index.js");
  const shown = [];
  const own = () => new Worker("/clients/web/lib/dist/worker.js", { type: "module" });
  for (const worker of [undefined, own, null]) {
    const drape = await connect(SERVICE, { worker });
    const first = async (options) => {
      const tube = await drape.wear("tube", options);
      const framed = new Promise((resolve) => tube.addEventListener("frame", resolve));
      await tube.follow(() => ({ poses: new Array(72).fill(0), trans: [0, 0, 0] }));
      await framed;
      const found = [tube.wearing.decoding.worker !== null, Array.from(tube.mesh.geometry.attributes.position.array)];
      tube.dispose();
      return found;
    };
    shown.push([...await first({ folds: 0 }), (await first({ folds: 1, folds_by: "client" }))[1]]);
  }
  return JSON.stringify(shown);
})()"""


class Files(SimpleHTTPRequestHandler):
    """The files of the repository; the pages name ``service`` and the garment that it has, and find a ``tracker``."""

    def __init__(self, *arguments: object, service: list[str], tracker: list[str], **named: object) -> None:
        self.service, self.tracker = service, tracker
        super().__init__(*arguments, **named)  # pyright: ignore[reportArgumentType]

    def do_GET(self) -> None:
        if self.path in WRITTEN:
            text = WRITTEN[self.path].replace("http://127.0.0.1:8000", self.service[0]).replace('"tshirt"', '"tube"')
            self.answer(text, "text/html")
        elif self.path == TRACKER_PATH and self.tracker:
            self.answer(self.tracker[0], "text/javascript")
        else:
            super().do_GET()

    def answer(self, text: str, kind: str) -> None:
        """Sends ``text``."""
        self.send_response(200)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(text.encode())))
        self.end_headers()
        self.wfile.write(text.encode())

    def log_message(self, format: str, *args: object) -> None:
        """Says nothing."""


@contextmanager
def strange_server(service: list[str], tracker: list[str] | None = None) -> Iterator[str]:
    """The origin of a server of the repository's files on another port; ``service`` gets the service's address, and
    ``tracker`` the text of one, once there is one."""
    files = partial(Files, directory=str(ROOT), service=service, tracker=tracker if tracker is not None else [])
    with ThreadingHTTPServer(("127.0.0.1", 0), files) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()


def test_thirty_lines_show_a_garment_that_moves(make_settings: Callable[..., Settings], record_property):
    assert len(WRITTEN[PAGE].splitlines()) <= 30
    service: list[str] = []
    with strange_server(service) as origin, served(make_settings(allowed_origins=(origin,))) as url:
        service.append(url)
        with open_page(origin + PAGE) as page:
            page.wait_for("Number(document.body?.dataset.frames) >= 2")
            before = page.wait_for_picture(lambda picture: picture.std() > 10.0, "the page is blank")
            before = page.wait_for_picture(lambda picture: share(picture, "b") > 0.005, "no garment in its colour")
            frames = page.evaluate("Number(document.body.dataset.frames)")
            page.wait_for(f"Number(document.body.dataset.frames) > {frames} + 5")
            page.wait_until_it_moves(before)
            first_s = float(page.evaluate("document.body.dataset.firstS"))
            record_property("first_frame_s", first_s)
            print(f"first frame after {first_s:.2f} s")
            shown = json.loads(page.evaluate(WORN_HERE.replace("SERVICE", json.dumps(url))))
            assert [in_worker for in_worker, *_ in shown] == [True, True, False]
            for kind in (1, 2):  # vertices as they come, and with folds that are made here
                same = shown[0][kind] == shown[1][kind] == shown[2][kind]
                assert same, "a worker decodes what the page's own thread does"
            assert shown[0][1] != shown[0][2]
            assert page.errors == []


@pytest.mark.long
def test_a_garment_follows_whoever_stands_before_the_camera(make_settings: Callable[..., Settings], body: BodyModel):
    points = person(body, read_motion(find_motions(("squat",))[0]).poses[::6], "mediapipe").round(4).tolist()
    service: list[str] = []
    tracker: list[str] = []
    with strange_server(service, tracker) as origin, served(make_settings(allowed_origins=(origin,))) as url:
        service.append(url)
        with open_page(f"{origin}{CAMERA}") as page:
            page.wait_for("document.querySelector('p')?.textContent.includes('tracker.js')")
            assert any("tracker.js" in error for error in page.errors)
            page.errors.clear()
            page.evaluate("globalThis.left = true")
            tracker.append(TRACKER.replace("POINTS", json.dumps(points)))
            page.go(f"{origin}{CAMERA}")
            page.wait_for("!globalThis.left && Number(document.body?.dataset.frames) >= 3")
            assert "33 points of mediapipe" in page.evaluate("document.body.dataset.told")
            assert page.evaluate("document.querySelector('p').textContent") == ""
            before = page.picture()
            frames = page.evaluate("Number(document.body.dataset.frames)")
            page.wait_for(f"Number(document.body.dataset.frames) > {frames} + 5")
            page.wait_until_it_moves(before)
            assert page.errors == []


def test_a_page_that_is_not_allowed_is_told_the_setting(live: str):
    with strange_server([live]) as origin, open_page(origin + PAGE) as page:
        asked = f"""(async () => {{
          const {{ connect }} = await import("/clients/web/lib/dist/core.js");
          try {{ await connect({json.dumps(live)}); }} catch (error) {{ return error.cure; }}
        }})()"""
        page.wait_for("document.readyState === 'complete'")
        assert f"DRAPE_ALLOWED_ORIGINS name {origin}?" in page.evaluate(asked)
