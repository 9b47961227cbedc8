"""The load test of streams: its figures, and a client of a real service."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from benchmarks.serving import LATE_S, ClientView, crowd, model_times, posts, server, stream_figures
from drape.catalog import find_motions
from drape.errors import DrapeError
from drape.motion.readers import read_motion
from tests.fixtures.serving import live, live_settings, make_settings, settings, tiny_folder

__all__ = ["live", "live_settings", "make_settings", "settings", "tiny_folder"]  # fixtures
CLIP = read_motion(find_motions(["walk"])[0])


def test_figures_are_of_all_clients_together():
    quick = ClientView(
        sent=4, came_s=[0.0, 0.03, 0.06], age_s=[0.01, 0.02, 0.03], residence_ms=[5.0, 6.0, 7.0], stepped=3
    )
    slow = ClientView(sent=4, came_s=[0.0, 0.5], age_s=[2.0 * LATE_S, LATE_S], residence_ms=[9.0, 10.0])
    found = stream_figures([quick, slow], np.array([3.0, 4.0, 5.0]))
    assert (found["goodput_pct"], found["served_pct"], found["stepped_pct"]) == (50.0, 62.5, 60.0)
    assert found["gap_max_ms"] == pytest.approx(500.0) and found["overhead_p50_ms"] == pytest.approx(3.0)
    assert found["overhead_p99_ms"] == pytest.approx(9.96 - 4.98)
    assert stream_figures([ClientView(sent=3)], np.ones(2)) == {"goodput_pct": 0.0}


def test_the_model_alone_takes_its_time_for_each_frame_of_every_tier(few_garments: tuple[str, ...]):
    found = model_times(few_garments[0], CLIP, 0.1)
    assert list(found) == ["instant", "fast", "balanced", "accurate", "POST /drape"]
    for took_ms in found.values():
        assert took_ms.shape == (3,) and (took_ms > 0.5).all()


def test_clients_of_a_service_are_measured(live: str):
    begun: list[bool] = []
    seen = asyncio.run(crowd(live, CLIP, 2, 0.4, begun=lambda: begun.append(True), garment="tube", tier="fast"))
    assert begun == [True]
    for one in seen:
        assert one.sent >= 3 and 0 < len(one.came_s) <= one.sent + 1
        assert min(one.residence_ms) > 0.0 and min(one.age_s) > 1e-3 * min(one.residence_ms)


def test_clients_have_the_next_garment_each(live: str):
    both = asyncio.run(crowd(live, CLIP, 2, 0.4, garments=("tube", "tube"), garment="nobody", tier="fast"))
    assert all(one.came_s for one in both)
    with pytest.raises(DrapeError, match="nobody"):
        asyncio.run(crowd(live, CLIP, 2, 0.4, garments=("tube", "nobody"), tier="fast"))


def test_single_frames_are_posted(live: str):
    took_ms = posts(live, "tube", CLIP, 0.1)
    assert took_ms.shape == (3,) and (took_ms > 0.5).all()
    with pytest.raises(RuntimeError, match="404"):
        posts(live, "nobody", CLIP, 0.1)


def test_a_server_that_does_not_start_is_told():
    with pytest.raises(RuntimeError, match=r"json\.tool did not start"), server("json.tool"):
        pass
