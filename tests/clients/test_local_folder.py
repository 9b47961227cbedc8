"""What the client makes of a folder without a service: files, refusals, and bodies at rest."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

from service.static.site import FORMAT
from tests.clients.node import answer_of, page_answer
from tests.clients.test_local import served_files

OPENED = """
const { openFolder } = await import(`${WEB}/lib/src/local.js`);
const { filesOf } = await import(`${WEB}/lib/src/files.js`);
const refusal = (task) => task.then(() => "", ({ name, kind, got, message }) => `${name} ${kind} ${got ?? ""}`);
const file = filesOf(`${input.url}good/`);
const text = async (name) => new TextDecoder().decode(await file(name));
const drape = await openFolder(`${input.url}good`);
console.log(JSON.stringify({
  texts: [await text("plain.txt"), await text("squeezed.gz")],
  health: drape.health,
  refused: [
    await refusal(openFolder(`${input.url}old/`)), await refusal(openFolder(`${input.url}none/`)),
    await refusal(drape.garments()), await refusal(drape.motion("walk")),
  ],
}));
"""


def test_files_are_read_compressed_or_not_and_what_is_missing_is_told(tmp_path: Path):
    for name, answers, number in (
        ("good", {"/health": "health.json.gz", "/garments": "gone.json"}, FORMAT),
        ("old", {}, 1),
    ):
        (tmp_path / name).mkdir()
        about = {"format": number, "answers": answers, "garment": "tube", "options": {}}
        (tmp_path / name / "about.json").write_text(json.dumps(about))
    (tmp_path / "good/health.json.gz").write_bytes(gzip.compress(b'{"body": "tall"}'))
    (tmp_path / "good/squeezed.gz").write_bytes(gzip.compress(b"told"))
    (tmp_path / "good/plain.txt").write_text("said")
    with served_files(tmp_path) as url:
        said = page_answer(OPENED, {"url": url}, tmp_path)
    assert said["texts"] == ["said", "told"]
    assert said["health"] == {"body": "tall"}
    assert said["refused"] == [
        "about.json ArtifactError 1",
        "about.json NotFound 404 File not found",
        "gone.json NotFound 404 File not found",
        "folder NotFound /motions/walk",
    ]


STILL = """
import { LocalStream } from "./local_stream.js";
let nowS = 5;
performance.now = () => 1000 * nowS;
const frames = [];
const opening = { folds: 1, safe_folds: 2, clearance_m: 0.002 };
const about = { garment: "tube", options: {}, opened: opening, joints: [[0, 1, 0]] };
const stream = new LocalStream(about, { onFrame: (frame) => frames.push(frame), onState() {} });
const early = stream.send(new Array(72).fill(0), [0, 0, 0]);
stream.open({ garment: "tube" });
const send = (angle, count) => {
  for (let i = 0; i < count; i++, nowS += 1 / 32) stream.send(new Array(72).fill(angle), [1, 2, 3]);
  return new Set(frames.splice(0).map(({ data }) => data)).size;
};
const counts = [send(0.1, 40), send(0.1, 40), send(0.1, 9), send(0.2, 9)];
stream.send(new Array(72).fill(0.2), [1, 2, 3]);
const [{ header, pose }] = frames;
stream.open({ garment: "tube", advanced: { folds: 4 }, push_out: false }); // at its old place
const opened = [stream.opened.folds, stream.opened.safe_folds, stream.opened.clearance_m];
stream.close();
console.log(JSON.stringify({ early, counts, root: header.root, opened, late: stream.send(pose, [0, 0, 0]) }));
"""


def test_a_body_that_stands_still_is_computed_until_its_cloth_rests(tmp_path: Path):
    said = answer_of(STILL, {}, tmp_path)
    assert said["counts"] == [40, 24, 1, 9]  # 64 frames of a 32nd of a second are two seconds
    assert (said["early"], said["late"]) == (False, False)
    assert said["root"] == [1, 3, 3]
    assert said["opened"] == [4, 4, 0]


FABRIC = """
import { LocalStream } from "./local_stream.js";
const said = [];
for (const options of [{}, { fabric: "denim" }]) {
  const about = { garment: "tube", options, opened: {}, joints: [[0, 1, 0]] };
  const onState = (state, refusal) => said.push([state, refusal?.name ?? ""]);
  const stream = new LocalStream(about, { onFrame() {}, onState });
  for (const fabric of [undefined, null, "denim"]) stream.open({ garment: "tube", fabric });
}
console.log(JSON.stringify(said));
"""


def test_a_folder_of_a_fabric_refuses_the_garment_s_own(tmp_path: Path):
    """``null`` asks for the garment's own fabric, which a folder in denim has not."""
    taken, refused = ["open", ""], ["refused", "fabric"]
    assert answer_of(FABRIC, {}, tmp_path) == [taken, taken, refused, taken, refused, taken]
