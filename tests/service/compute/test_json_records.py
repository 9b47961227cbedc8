"""Records on disk that cannot be read are named in the log and stop no list and no start."""

from __future__ import annotations

import json
import logging
import shutil
from collections.abc import Callable
from pathlib import Path

import httpx
import numpy as np
import pytest

from drape.body.model import BodyModel
from drape.errors import ArtifactError
from drape.garment.cache import save_garment
from service.compute.avatars import FOLDER as AVATARS
from service.compute.avatars import AvatarRecord
from service.compute.garment_files import IDS, about_path, read_about
from service.compute.json_records import read_record
from service.exact import clip_folder as clips
from service.exact.clip_folder import write_frame
from service.settings import Settings
from service.uploads import accepted, job_records
from tests.fixtures.garments import tube_garment
from tests.fixtures.serving import served

JOB = "0123456789ab"
KEPT = {
    "avatar": {"id": "me", "owner": None, "told": {
        "name": "me", "digest": "d", "joints": {}, "nodes": [], "fit": {}, "height_m": 1.7, "rest_joints": [],
        "floor_m": 0.0, "scale": 1.0, "vrm": None, "vertices": 3}},
    "job": {"id": JOB, "name": "a", "owner": None, "state": "done", "garment": "a"},
    "upload": {"id": JOB, "name": "a", "owner": None, "file": "a.obj", "avatar": None},
    "clip": {"id": JOB, "name": "tube", "owner": None, "frames": 2},
    "about": {"title": "Kleid", "published": True},
}  # fmt: skip


def spoilt(record: dict) -> dict[str, bytes]:
    """``record`` as other things that may lie in its place."""
    text = json.dumps(record).encode()
    first = next(key for key, value in record.items() if value)
    return {
        "nothing": b"",
        "half": text[: len(text) // 2],
        "a list": b"[]",
        "a number": b"5",
        "deep": b"[" * 100_000,
        "bytes": bytes(range(256)),
        "half a pair": json.dumps(record | {first: "\ud800"}).encode(),
        "another type": json.dumps(record | {first: [{}]}).encode(),
        "another type of each": json.dumps({key: [5] for key in record}).encode(),
    }


def spoil(root: Path, body: BodyModel) -> int:
    """Fills a folder of uploads with records that cannot be read, of each kind; how many of avatars."""
    homes: dict[str, Callable[[int], Path]] = {
        "avatar": lambda n: root / AVATARS / f"a{n}.json",
        "job": lambda n: root / job_records.FOLDER / f"{n:012x}.json",
        "upload": lambda n: root / f"{accepted.STAGING}0-{accepted._host()}-99999999" / f"{n:012x}" / accepted.ABOUT,
        "clip": lambda n: root / clips.FOLDER / f"{n:012x}" / clips.ABOUT,
    }
    for kind, home in homes.items():
        for number, content in enumerate(spoilt(KEPT[kind]).values()):
            home(number).parent.mkdir(parents=True, exist_ok=True)
            home(number).write_bytes(content)
            (home(number).parent / "a.obj").write_bytes(b"v 0 0 0")
    cache = save_garment(tube_garment(body, name="gown"), root)
    about_path(cache).write_bytes(spoilt(KEPT["about"])["half a pair"])
    (root / "half.npz").write_bytes(cache.read_bytes()[:2000])
    (root / "caf\udce9.npz").write_bytes(b"PK")  # as a name in Latin-1 is seen
    shutil.copy(cache, root / "copy.npz")
    (root / IDS).mkdir(exist_ok=True)
    (root / IDS / "gown").write_bytes(b"\xff\x00" + b"x" * 5000)
    clip = root / clips.FOLDER / JOB
    clip.mkdir()
    (clip / clips.ABOUT).write_text(json.dumps(KEPT["clip"]))
    (clip / clips.CLIP).write_bytes(b"")
    write_frame(clip, 0, np.zeros((3, 3), np.float32), dict.fromkeys(clips.FIGURES, 0.0))
    whole = clips.frame_path(clip, 0)
    clips.frame_path(clip, 1).write_bytes(whole.read_bytes()[:-40])
    write_frame(clip, 0, np.zeros((3, 3), np.float32), dict.fromkeys(clips.FIGURES, np.inf))
    (root / AVATARS / "me.json").write_text(json.dumps(KEPT["avatar"]))
    (root / AVATARS / "me.npz").write_bytes(b"PK\x03\x04 cut off")
    return len(spoilt(KEPT["avatar"]))


def test_a_start_and_every_list_pass_over_what_cannot_be_read(
    make_settings: Callable[..., Settings], body: BodyModel, caplog: pytest.LogCaptureFixture
):
    settings = make_settings()
    count = spoil(settings.garments_dir, body)
    with caplog.at_level(logging.WARNING), served(settings) as url, httpx.Client(base_url=url, timeout=60.0) as api:
        assert [entry["id"] for entry in api.get("/avatars").json()] == ["me"]
        worn = {"garment": "tube", "poses": np.zeros((1, 24, 3)).tolist(), "avatar": "me"}
        answer = api.post("/drape", json=worn)
        assert answer.status_code == 404 and "Send the character again" in answer.json()["cure"]
        assert api.get("/avatars").json() == [] and api.get("/avatars/me").status_code == 404
        garments = api.get("/garments").json()
        assert {garment["name"] for garment in garments} == {"tube", "gown"}
        for number in range(count):
            assert api.get(f"/jobs/{number:012x}").status_code == 404
        assert api.get(f"/jobs/{JOB}").json()["state"] in ("queued", "running", "failed")  # its message is empty
        assert len(api.get("/health").json()["refused_garments"]) == 3
        assert api.get("/livez").status_code == 200
    told = [record.getMessage() for record in caplog.records if "set aside" in record.getMessage()]
    for place in (AVATARS, job_records.FOLDER, accepted.STAGING, clips.FOLDER, "half.npz", r"caf\udce9.npz"):
        assert any(place in line for line in told), place
    assert (settings.garments_dir / clips.FOLDER / f"{1:012x}" / clips.ABOUT).exists(), "nothing is thrown away"


def test_a_record_is_read_whole_or_not_at_all(tmp_path: Path):
    path = tmp_path / "one.json"
    path.write_text(json.dumps(KEPT["avatar"]))
    assert read_record(AvatarRecord, path) is not None
    for name, content in spoilt(KEPT["avatar"]).items():
        path.write_bytes(content)
        assert read_record(AvatarRecord, path) is None, name


@pytest.mark.parametrize("content", spoilt(KEPT["about"]).values(), ids=spoilt(KEPT["about"]))
def test_what_is_said_of_a_garment_is_read_or_refused(content: bytes, tmp_path: Path):
    about_path(tmp_path / "gown.npz").write_bytes(content)
    with pytest.raises(ArtifactError, match="title and published"):
        read_about(tmp_path / "gown.npz")
