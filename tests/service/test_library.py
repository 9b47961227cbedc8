"""A program without a service has the bytes that the service sends."""

from __future__ import annotations

import httpx
import numpy as np

import drape
from service.settings import Settings
from tests.fixtures.garments import ship
from tests.fixtures.serving import served


def test_frames_of_the_library_are_those_of_the_service(tmp_path):
    worn = drape.load().wear("tank", tier="balanced", fabric="denim")
    clip = worn.placed("walk").window(0, 20)
    document = {
        "garment": "tank", "tier": "balanced", "fabric": "denim", "fps": clip.fps,
        "poses": clip.poses.tolist(), "trans": clip.trans.tolist(),
    }  # fmt: skip
    with served(Settings(shipped_garments_dir=ship(tmp_path / "shipped", "tank"), garments_dir=tmp_path)) as url:
        answer = httpx.post(f"{url}/drape", json=document, headers={"Accept": "application/octet-stream"}, timeout=60.0)
    assert answer.status_code == 200, answer.text
    played = np.stack([one.vertices for one in worn.play(clip, as_recorded=True)])
    assert answer.content == played.astype("<f4").tobytes()
