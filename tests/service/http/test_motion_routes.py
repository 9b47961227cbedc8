"""Motion files by REST: each kind comes back as our own npz, and what cannot be read is refused in words."""

from __future__ import annotations

import os
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest

from drape.motion.clip import MotionClip
from drape.motion.readers import read_motion
from service.settings import Settings
from service.uploads import motions
from service.uploads.sandbox import MOST_FRAMES
from tests.drape.motion.node_files import CLIP, T_POSE, fbx, glb, moved
from tests.fixtures.meshes import huge_count_glb
from tests.fixtures.patience import PATIENT_S, wait_until
from tests.fixtures.serving import files_in, served


def asked(api: httpx.Client, payload: bytes, **query: str) -> httpx.Response:
    return api.post("/motions", params=query, content=payload)


def payload_of(suffix: str, folder: Path) -> bytes:
    if suffix == ".fbx":
        pytest.importorskip("ufbx", reason="No ufbx: `pip install ufbx`.")
        return fbx()
    path = folder / f"clip{suffix}"
    if suffix == ".npz":
        CLIP.save(path)
    else:
        return glb(*moved("vrm", T_POSE))
    return path.read_bytes()


@pytest.mark.parametrize("suffix", [".npz", ".vrma", ".fbx"])
def test_a_file_of_any_kind_comes_back_as_what_the_reader_makes_of_it(
    api: httpx.Client, settings: Settings, suffix: str, tmp_path: Path
):
    payload = payload_of(suffix, tmp_path)
    (tmp_path / f"Walk{suffix}").write_bytes(payload)
    answer = asked(api, payload, name=f"Walk{suffix.upper()}")
    assert (answer.status_code, answer.headers["Content-Type"]) == (200, "application/octet-stream"), answer.text
    (tmp_path / "found.npz").write_bytes(answer.content)
    found, own = read_motion(tmp_path / "found.npz"), read_motion(tmp_path / f"Walk{suffix}")
    np.testing.assert_array_equal(found.poses, own.poses.astype(np.float32))
    np.testing.assert_array_equal(found.trans, own.trans.astype(np.float32))
    assert found.fps == pytest.approx(own.fps)
    assert files_in(settings.garments_dir) == []


def test_a_clip_is_chosen_by_its_name(api: httpx.Client):
    payload = glb(*moved("mixamo", T_POSE))
    assert asked(api, payload, name="all.glb", clip="walk").status_code == 200
    refused = asked(api, payload, name="all.glb", clip="run")
    assert refused.status_code == 422 and "one of 'walk', got 'run'" in refused.json()["detail"]


def test_what_is_no_motion_is_refused_in_words(api: httpx.Client, settings: Settings):
    cases: list[tuple[bytes, dict[str, str], int, str]] = [
        (b"x", {"name": "dance.mp4"}, 400, "the name of a motion file"),
        (b"x", {}, 400, "name"),
        (b"x", {"name": "a.bvh", "klip": "x"}, 400, "did you mean"),
        (b"", {"name": "a.bvh"}, 422, "the bytes of a motion file"),
        (os.urandom(500), {"name": "a.npz"}, 422, "a readable npz file"),
        (huge_count_glb(), {"name": "bomb.vrma"}, 422, "an animation"),
        (b"x", {"name": "a.fbx", "clip": "a\0b"}, 422, "FBX" if not have_ufbx() else "a motion that can be read"),
        (bytes(4 * 2**20), {"name": "a.npz"}, 413, "request body"),
    ]
    for payload, query, status, words in cases:
        answer = asked(api, payload, **query)
        assert answer.status_code == status and words.lower() in answer.json()["detail"].lower(), answer.text
        assert str(settings.garments_dir) not in answer.text
    assert files_in(settings.garments_dir) == []


def have_ufbx() -> bool:
    try:
        import ufbx  # noqa: F401
    except ImportError:
        return False
    return True


def test_a_motion_of_an_hour_is_refused(api: httpx.Client, tmp_path: Path):
    count = MOST_FRAMES + 1
    MotionClip(np.zeros((count, 24, 3)), np.zeros((count, 3)), 60.0, "long").save(tmp_path / "long.npz")
    answer = asked(api, (tmp_path / "long.npz").read_bytes(), name="long.npz")
    assert answer.status_code == 413 and f"at most {MOST_FRAMES} frames, got {count}" in answer.json()["detail"]


def slow_bvh() -> bytes:
    """Frames that are many to parse."""
    joint = "JOINT j { OFFSET 0 1 0 CHANNELS 3 Zrotation Xrotation Yrotation End Site { OFFSET 0 1 0 } }"
    head = f"HIERARCHY ROOT a {{ OFFSET 0 0 0 CHANNELS 3 Xposition Yposition Zposition {joint} }} MOTION "
    return (head + "Frames: 200000 Frame Time: 0.01\n").encode() + b"0.5 0.5 0.5 0.5 0.5 0.5\n" * 200_000


def test_limits_end_the_reader_and_a_full_queue_is_refused(make_settings: Callable[..., Settings], monkeypatch):
    monkeypatch.setattr(motions, "READ_S", 0.3)
    settings = make_settings(intake_queue=1)
    with served(settings) as url, httpx.Client(base_url=url, timeout=60.0) as api:
        late: list[httpx.Response] = []
        refused = threading.Event()

        def body() -> Iterator[bytes]:
            yield slow_bvh()
            refused.wait(PATIENT_S)
            yield b"\n"

        first = threading.Thread(
            target=lambda: late.append(api.post("/motions?name=slow.bvh", content=body(), timeout=PATIENT_S))
        )
        first.start()
        wait_until(lambda: list(settings.garments_dir.glob("*/motion-*")))
        busy = asked(api, b"x", name="a.bvh")
        refused.set()
        assert busy.status_code == 429 and "fewer than 1 waiting" in busy.json()["detail"]
        first.join()
        assert late[0].status_code == 413 and "within 0.3 s" in late[0].json()["detail"], late[0].text
        assert files_in(settings.garments_dir) == []
    listed = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout
    assert str(settings.garments_dir) not in listed


def test_a_client_that_leaves_ends_its_reader(make_settings: Callable[..., Settings]):
    settings = make_settings()
    with served(settings) as url:
        with pytest.raises(httpx.ReadTimeout):
            httpx.post(f"{url}/motions?name=slow.bvh", content=slow_bvh(), timeout=0.5)
        wait_until(lambda: not files_in(settings.garments_dir))
        listed = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout
        assert str(settings.garments_dir) not in listed
