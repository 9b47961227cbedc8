"""The web page in headless Chromium: a garment on a body, moving, without a console error."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drape.body.model import BodyModel
from drape.catalog import find_motions
from drape.motion.readers import read_motion
from tests.architecture.repository import ROOT
from tests.clients.browser import Page, open_page, violations
from tests.clients.people import person
from tests.clients.test_vmc import bridge, packets, send
from tests.drape.motion.node_files import T_POSE, glb, moved

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def page(live: str) -> Iterator[Page]:
    with open_page(live + "/?garment=tube&clip=reach", height=800) as page:
        page.wait_for("Number(document.body?.dataset.frames) >= 3")
        set_control(page, "colour", "value", "#2f6fb0", "input")  # the page's own are greys
        yield page


def stage(picture: np.ndarray) -> np.ndarray:
    """What of a page 900 pixels wide is free of controls: beside the shelf, below the chips, above what is said."""
    return picture[140 : len(picture) - 240, :560]


def share(scene: np.ndarray, colour: str) -> float:
    """Share of ``scene`` in which ``colour`` (a channel) stands out."""
    channel = "rgb".index(colour)
    others = [scene[..., i] for i in range(3) if i != channel]
    return float((scene[..., channel] > 1.35 * np.maximum(*others) + 8).mean())


def set_control(page: Page, element: str, name: str, value: object, event: str) -> None:
    """Sets a property of a control and tells the page, as a user's hand would."""
    page.evaluate(
        f"""(() => {{
        const control = document.getElementById({json.dumps(element)});
        control[{json.dumps(name)}] = {json.dumps(value)};
        control.dispatchEvent(new Event({json.dumps(event)}));
        }})()"""
    )


def test_it_opens_on_garments_that_are_shipped():
    source = (ROOT / "clients/web/src/first.js").read_text(encoding="utf-8")
    worn = source.partition('const WORN = "')[2].partition('"')[0].split(",")
    assert len(worn) == 2 and all(list((ROOT / "drape/assets/garments").glob(f"{name}-*.npz")) for name in worn)


def test_it_draws_with_webgl_and_says_so(page: Page):
    name = page.evaluate(
        """(() => { const gl = document.createElement("canvas").getContext("webgl2");
        return gl && gl.getParameter(gl.getExtension("WEBGL_debug_renderer_info").UNMASKED_RENDERER_WEBGL); })()"""
    )
    assert name
    assert page.evaluate("document.body.dataset.state") == "open"


def test_the_garment_and_the_body_are_in_the_picture(page: Page):
    picture = stage(page.picture())
    assert picture.std() > 10.0, "the page is blank"
    assert 0.005 < share(picture, "b") < 0.3, "no garment in its colour"
    red, green, blue = (picture[..., i] for i in range(3))
    skin = (red > green) & (green > blue) & (red - blue > 35)
    assert skin.mean() > 0.01, "no body"


def test_the_picture_moves(page: Page):
    before = stage(page.picture())
    more_frames(page, 5)
    page.wait_for_picture(lambda now: differ(stage(now), before), "nothing moves")


def differ(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether more than a thousandth of two pictures differs."""
    return (np.abs(one - other).max(axis=-1) > 30).mean() > 0.001


def more_frames(page: Page, count: int = 2) -> None:
    """Waits until ``count`` more frames than now are shown."""
    frames = page.evaluate("Number(document.body.dataset.frames)")
    page.wait_for(f"Number(document.body.dataset.frames) >= {frames} + {count}")


def test_paused_it_stands_still_and_goes_on(page: Page):
    moment = "document.getElementById('scrub').value"
    click(page, "play")
    assert page.evaluate("document.getElementById('play').getAttribute('aria-label')") == "Play"
    before = page.evaluate(moment)
    more_frames(page)
    assert page.evaluate(moment) == before
    press(page, " ")
    page.wait_for(f"{moment} !== {before!r}")


def click(page: Page, element: str) -> None:
    page.evaluate(f"(() => {{ document.getElementById({element!r}).click(); return true; }})()")


def press(page: Page, key: str) -> None:
    event = f"new KeyboardEvent('keydown', {{ key: {key!r}, bubbles: true }})"
    page.evaluate(f"(() => {{ document.activeElement.blur(); return document.body.dispatchEvent({event}); }})()")


def test_numbers_lie_behind_a_key(page: Page):
    hidden = "document.getElementById('readouts').hidden"
    assert page.evaluate(hidden)
    press(page, "d")
    assert not page.evaluate(hidden)
    page.wait_for("Number(document.getElementById('fps').textContent) > 0")
    assert page.evaluate("document.getElementById('age').textContent").endswith(" ms")
    assert page.evaluate("document.getElementById('pushed').textContent").endswith(" %")
    press(page, "d")
    assert page.evaluate(hidden)


def test_what_a_frame_takes_stands_beside_the_quality(page: Page):
    page.wait_for("/^\\d+ ms$/.test(document.getElementById('ms').textContent)")
    assert page.evaluate("document.querySelector('#tiers input:checked').value") == "balanced", "the service's default"


def test_each_quality_has_a_number_as_its_key(page: Page):
    names = page.evaluate("Array.from(document.querySelectorAll('#tiers input'), (choice) => choice.value)")
    places = [*range(len(names)), names.index("balanced")]
    for place in places:
        press(page, str(place + 1))
        assert page.evaluate("document.querySelector('#tiers input:checked').value") == names[place]
    more_frames(page)


def test_the_controls_do_what_they_say(page: Page):
    set_control(page, "colour", "value", "#c02020", "input")
    page.evaluate("(() => { document.querySelector('[data-clip=squat]').click(); return true; })()")
    set_control(page, "push", "checked", False, "change")
    page.wait_for("document.getElementById('pushed').textContent === 'off'")
    page.wait_for("document.querySelector('[data-clip=squat]').getAttribute('aria-pressed') === 'true'")
    more_frames(page)
    picture = stage(page.picture())
    assert share(picture, "b") < 0.001
    assert share(picture, "r") > 0.005


def test_the_finer_mesh_is_fetched_with_the_frames_that_have_it(page: Page):
    fetched = "performance.getEntriesByType('resource').map((entry) => entry.name).join(' ')"
    assert "/garments/tube/mesh?resolution=fine" not in page.evaluate(fetched)
    set_control(page, "resolution", "value", "fine", "change")
    page.wait_for(f"{fetched}.includes('/garments/tube/mesh?resolution=fine')")
    more_frames(page)
    page.wait_for("document.body.dataset.state === 'open'")
    set_control(page, "resolution", "value", "", "change")


def test_a_measure_changes_the_body_and_leaves_the_others(page: Page):
    told = "Array.from(document.querySelectorAll('.measure output'), (one) => one.textContent)"
    before = page.evaluate(told)
    set_control(page, "waist_m", "value", 90, "input")
    set_control(page, "waist_m", "value", 90, "change")
    meshes = "performance.getEntriesByType('resource').filter(({ name }) => /mesh\\?betas=-?\\d/.test(name)).length"
    page.wait_for(f"{meshes} === 1")
    more_frames(page)
    after = page.evaluate(told)
    assert after[2] == "90 cm" != before[2] and after[:2] + after[3:] == before[:2] + before[3:]
    click(page, "usual")
    page.wait_for(f"{told}.join() === {','.join(before)!r}")


def test_fit_tells_words_and_paints_the_cloth(page: Page):
    set_control(page, "push", "checked", True, "change")
    press(page, "f")
    said = page.wait_for("document.querySelector('#fit-words li:not(:empty)')?.textContent")
    page.wait_for("!document.getElementById('fit-words').textContent.startsWith('Measuring')")
    assert said and page.evaluate("document.getElementById('fit').getAttribute('aria-pressed')") == "true"
    press(page, "f")
    assert page.evaluate("document.getElementById('fit-card').hidden")


def test_a_motion_of_a_file_is_played(page: Page, tmp_path: Path):
    page.choose_file("#motion-file", ROOT / "drape/assets/motions/reach.npz")
    page.wait_for("document.querySelector('[data-clip=own-1]')?.getAttribute('aria-pressed') === 'true'")
    more_frames(page)
    spoiled = tmp_path / "spoiled.npz"
    spoiled.write_bytes(b"no zip at all, but long enough to look for one")
    page.choose_file("#motion-file", spoiled)
    assert "a readable npz file" in page.wait_for("document.querySelector('#message.bad')?.textContent")
    assert page.evaluate("document.querySelector('#clips [aria-pressed=true]').dataset.clip") == "own-1"


def test_a_dropped_animation_is_played_and_its_clips_are_listed(page: Page, tmp_path: Path):
    payload = glb(*moved("mixamo", T_POSE), clips=("walk", "stroll"))
    (tmp_path / "moves.glb").write_bytes(payload)
    page.drop(tmp_path / "moves.glb")
    names = "Array.from(document.querySelectorAll('[data-clip^=own-]'), (chip) => chip.textContent)"
    page.wait_for(f"{names}.slice(-2).join() === 'Walk,Stroll'")
    page.wait_for("document.querySelector('#clips [aria-pressed=true]').textContent === 'Walk'")
    more_frames(page)


# A tracker that sees a person squat, for as long as it is asked.
TRACKER = """export async function track(video, put, files) {
  if (!video.videoWidth || !files["tracker.js"]) throw new Error("no picture, or no files");
  const reached = await fetch("SERVICE/health").then(() => "the service", () => "");
  if (reached) throw new Error("it reaches " + reached);
  const points = POINTS;
  for (let n = 0; ; n++) {
    put(points[n % points.length]);
    await new Promise((done) => setTimeout(done, 30));
  }
}"""
CHOSEN = "document.querySelector('#clips [aria-pressed=true]').dataset.clip"
DENIED = """(() => {
  navigator.mediaDevices.getUserMedia = async () => { throw new DOMException("no", ERROR); };
  return true;
})()"""


def test_whoever_stands_before_the_camera_moves_the_person(page: Page, body: BodyModel, tmp_path: Path, live: str):
    points = person(body, read_motion(find_motions(("squat",))[0]).poses[::6], "mediapipe").round(4).tolist()
    before = page.evaluate(CHOSEN)
    click(page, "camera-open")
    assert page.evaluate("document.getElementById('camera-door').open")
    tracker = tmp_path / "tracker.js"
    tracker.write_text(TRACKER.replace("POINTS", json.dumps(points)).replace("SERVICE", live))
    page.choose_file("#tracker-files", tracker)
    page.wait_for(f"{CHOSEN} === 'camera' && document.getElementById('camera')?.hidden === false")
    page.wait_for("document.getElementById('scrub').disabled && !document.getElementById('message').textContent")
    still = stage(page.picture())
    more_frames(page, 6)
    page.wait_for_picture(lambda now: differ(stage(now), still), "nothing moves")
    page.evaluate(f"(() => {{ document.querySelector('[data-clip=\"{before}\"]').click(); return true; }})()")
    page.wait_for("document.getElementById('camera').hidden && !document.getElementById('scrub').disabled")
    assert page.evaluate(CHOSEN) == before


def test_a_sender_of_vmc_moves_the_person_until_it_ends(page: Page, live: str):
    """On the ports that the page knows; who has them already has a bridge."""
    before = page.evaluate(CHOSEN)
    press(page, "v")
    page.wait_for("document.querySelector('#message.bad')?.textContent.includes('python -m clients.vmc')")
    assert page.evaluate(CHOSEN) == before and page.evaluate("!document.querySelector('[data-clip=vmc]')")
    page.errors.clear()  # the browser tells of the connection
    with bridge("--port", "0", "--page", live) as (port, _):
        press(page, "v")
        page.wait_for("document.querySelector('[data-clip=vmc]')?.getAttribute('aria-pressed') === 'true'")
        send(port, *packets(30))
        more_frames(page, 2)
        still = stage(page.picture())
        send(port, *packets(200))
        page.wait_for_picture(lambda now: differ(stage(now), still), "nothing moves")
    page.wait_for("document.querySelector('#message.bad')?.textContent.includes('has ended')")
    page.wait_for("document.querySelector('#clips [aria-pressed=true]').dataset.clip !== 'vmc'")


@pytest.mark.parametrize(
    ("error", "words"), [("NotAllowedError", "may not use the camera"), ("NotFoundError", "no camera at this machine")]
)
def test_a_camera_that_does_not_come_is_told_and_the_motion_stays(page: Page, error: str, words: str):
    before = page.evaluate(CHOSEN)
    page.evaluate(DENIED.replace("ERROR", json.dumps(error)))
    click(page, "camera-open")
    page.wait_for(f"document.querySelector('#message.bad')?.textContent.includes({json.dumps(words)})")
    page.wait_for(f"{CHOSEN} === {json.dumps(before)}")
    more_frames(page)


def test_a_file_that_is_no_tracker_is_refused_in_words(page: Page, tmp_path: Path):
    none = tmp_path / "other.js"
    none.write_text("export const found = 1;")
    page.choose_file("#tracker-files", none)
    said = "expected a module with a function track(video, put), got other.js"
    page.wait_for(f"document.querySelector('#message.bad')?.textContent.includes({json.dumps(said)})")


def test_folds_are_made_where_they_are_asked_for(page: Page):
    set_control(page, "folds", "value", "1", "change")
    set_control(page, "folds-by", "value", "client", "change")
    page.wait_for("document.getElementById('here-ms').textContent.endsWith(' ms')")
    assert not page.evaluate("document.getElementById('here').hidden")
    assert page.evaluate("document.getElementById('ms').textContent").endswith(" ms")
    more_frames(page)
    set_control(page, "folds-by", "value", "server", "change")
    page.wait_for("document.getElementById('here').hidden")
    set_control(page, "folds", "value", "", "change")
    more_frames(page)


def test_a_size_is_chosen_and_what_the_body_takes_is_marked(page: Page):
    click(page, "tab-fabric")
    page.wait_for("document.querySelector('.size.taken')?.dataset.size === 'M'")
    advice = page.evaluate("document.getElementById('size-advice').textContent")
    assert advice.startswith("This body takes M: chest ")
    page.evaluate("(() => { document.querySelector('[data-size=XL]').click(); return true; })()")
    page.wait_for("performance.getEntriesByType('resource').some(({ name }) => name.includes('size=XL'))")
    page.wait_for("!document.getElementById('message').textContent")
    assert page.evaluate("document.querySelector('#worn .pick').textContent") == "Tube XL"
    assert page.evaluate("document.getElementById('size-measures').textContent").startswith("XL: chest 129 cm")
    more_frames(page)
    page.evaluate("(() => { document.querySelector('[data-size=M]').click(); return true; })()")
    more_frames(page)


def test_a_refused_upload_is_told_in_words(page: Page, tmp_path: Path):
    noise = tmp_path / "noise.obj"
    noise.write_bytes(b"nothing that is a mesh\n")
    page.choose_file("#file", noise)
    said = "document.querySelector('#message.bad')?.textContent"
    page.wait_for(f"{said}?.includes('noise')")
    assert "expected" in page.evaluate(said)
    more_frames(page, 1)


DROP = """(() => {
  const files = new DataTransfer();
  files.items.add(new File(["words"], "notes.txt"));
  for (const kind of ["dragenter", "drop"]) {
    document.body.dispatchEvent(new DragEvent(kind, { bubbles: true, cancelable: true, dataTransfer: files }));
  }
  return true;
})()"""


def test_a_dropped_file_of_no_kind_is_told(page: Page):
    page.evaluate(DROP)
    page.wait_for("document.querySelector('#message.bad')?.textContent.startsWith('notes.txt is none of')")
    assert page.evaluate("document.getElementById('drop').hidden")


# Keeps the page's sockets, so that one can be ended as a lost connection is, and the states that it goes through.
SPY = """(() => {
  window.states = [];
  const offline = document.getElementById("offline");
  new MutationObserver(() => window.states.push([document.body.dataset.state, offline.hidden]))
    .observe(document.body, { attributeFilter: ["data-state"] });
  const send = WebSocket.prototype.send;
  WebSocket.prototype.send = function (data) {
    window.socket = this;
    return send.call(this, data);
  };
  return true;
})()"""


def test_a_lost_stream_is_told_and_comes_back(page: Page):
    page.evaluate(SPY)
    more_frames(page)
    page.wait_for("window.socket !== undefined")
    page.evaluate("(() => { window.socket.close(); return true; })()")
    page.wait_for("window.states.some(([state]) => state === 'waiting')")
    page.wait_for("document.body.dataset.state === 'open'")
    assert ["waiting", False] in page.evaluate("window.states"), "nothing was said"
    assert page.evaluate("document.getElementById('offline').hidden")
    more_frames(page)


@pytest.mark.parametrize("drawer", ["wear", "fabric", "body"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nobody_is_kept_out(page: Page, scheme: str, drawer: str):
    page.media(scheme=scheme)
    click(page, f"tab-{drawer}")
    assert violations(page) == []


def test_no_console_error_so_far(page: Page):
    assert page.errors == []
