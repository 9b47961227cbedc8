"""What is read of Lighthouse's report, trace and log: scores, and the bytes until cloth moves."""

from __future__ import annotations

import base64

import pytest

from benchmarks.page import moved, scored


def test_scores_are_of_a_hundred_and_times_in_seconds():
    names = ("first-contentful-paint", "largest-contentful-paint", "total-blocking-time", "speed-index")
    audits = {name: {"numericValue": 1500.0} for name in (*names, "cumulative-layout-shift", "total-byte-weight")}
    row = scored({"audits": audits, "categories": {"performance": {"score": 0.385}, "seo": {"score": 1}}})
    assert (row["performance"], row["seo"], row["largest_paint_s"], row["loaded_kb"]) == (38, 100, 1.5, 1.5)
    assert "accessibility" not in row
    audits["total-blocking-time"] = {}
    unsure = scored({"audits": audits, "categories": {"performance": {"score": None}}})
    assert "performance" not in unsure and "blocking_s" not in unsure


def event(name: str, ts: float, cat: str = "blink.user_timing", url: str = "http://127.0.0.1/") -> dict:
    return {"name": name, "ts": ts, "cat": cat, "args": {"data": {"documentLoaderURL": url}}}


def test_bytes_until_cloth_moves_are_files_and_frames_of_the_last_visit():
    trace = [
        event("navigationStart", 1e6),
        event("navigationStart", 5e6),
        event("navigationStart", 6e6, url=""),
        event("moving", 7.5e6),
        event("moving", 9e6, "x"),
    ]
    frame = base64.b64encode(bytes(3000)).decode()

    def said(method: str, second: float, **told: object) -> dict:
        return {"method": f"Network.{method}", "params": {"timestamp": second, **told}}

    log = [
        said("loadingFinished", 4.0, encodedDataLength=9e9),  # before the visit
        said("loadingFinished", 6.0, encodedDataLength=1000),
        said("webSocketFrameReceived", 7.0, response={"opcode": 2, "payloadData": frame}),
        said("webSocketFrameReceived", 7.1, response={"opcode": 1, "payloadData": 10 * "a"}),
        said("loadingFinished", 8.0, encodedDataLength=9e9),  # after it
        {"method": "Network.other", "params": {}},
    ]
    row = moved(trace, log)
    assert row == {"moves_s": 2.5, "moving_kb": pytest.approx(4.01)}
    assert moved(trace[:2], log) == {}
