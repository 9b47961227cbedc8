"""Counts and measurements of the service, in the text format of Prometheus: ``Metrics``.

No series is per client, garment or request id: their number would grow with the traffic.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import cast

import numpy as np
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4
from prometheus_client.metrics_core import CounterMetricFamily
from prometheus_client.registry import Collector

from service.watch.outputs import dropped_lines

SECONDS = (0.001, 0.002, 0.005, 0.01, 0.016, 0.033, 0.066, 0.1, 0.2, 0.5, 1.0, 3.0, 10.0, 60.0)
FRAMES = (1, 2, 4, 8, 16, 32, 64, 128, 256)
METRES = (0.0, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
SHARES = (0.0, 0.01, 0.05, 0.1, 0.2, 0.5, 1.0)
MEDIA_TYPE = CONTENT_TYPE_PLAIN_0_0_4


class Metrics:
    """The series of one service; every method may be called from any thread."""

    def __init__(self) -> None:
        registry = self.registry = CollectorRegistry()
        ProcessCollector(registry=registry)

        def counter(name: str, what: str, *labels: str) -> Counter:
            return Counter(f"drape_{name}", what, labels, registry=registry)

        def gauge(name: str, what: str) -> Gauge:
            return Gauge(f"drape_{name}", what, registry=registry)

        def histogram(name: str, what: str, buckets: tuple[float, ...], *labels: str) -> Histogram:
            return Histogram(f"drape_{name}", what, labels, registry=registry, buckets=buckets)

        # Streams.
        self.poses = counter("poses", "Poses that streams sent.")
        self.poses_dropped = counter("poses_dropped", "Poses that a newer one replaced before they were draped.")
        self.frames_sent = counter("frames_sent", "Frames handed to streams' connections.")
        self.frames_on_time = counter("frames_on_time", "Of these, within DRAPE_FRAME_DEADLINE_S of their pose.")
        self.frame_age = histogram("frame_age_seconds", "From a pose's coming to its frame's leaving.", SECONDS)
        self.ack = histogram("frame_acknowledged_seconds", "From a frame's being ready to its being taken.", SECONDS)
        self.batch_frames = histogram("batch_frames", "Streams' frames computed together.", FRAMES)
        self.streams = gauge("streams", "Open streams.")
        self.poses_waiting = gauge("poses_waiting", "Poses that wait for the worker or for credit.")
        self.evictions = counter("evictions", "Streams ended by the service, by kind of refusal.", "kind")
        self.moved = counter("streams_moved", "Streams that went to another process, by whether with state.", "state")
        self.brought = counter("streams_brought", "Streams that came with a state, by whether they go on.", "resumed")
        # A frame on its way.
        self.stage = histogram("stage_seconds", "Of one batch in a stage.", SECONDS, "stage")
        self.frames = counter("frames", "Frames draped, for streams and clips.")
        self.folds_resets = counter("folds_resets", "Layers whose folds were begun anew.")
        self.pushed_share = histogram("pushed_share", "Of a frame's vertices, moved by the push-out.", SHARES)
        self.push_max = histogram("push_max_meters", "Furthest way of a vertex in the push-out, by frame.", METRES)
        self.jets_left = histogram("jets_left_meters", "What jets lack of the push-out at most, by frame.", METRES)
        # A card that draws folds.
        self.card_works = gauge("card_works", "Whether the card draws frames; 0 once it has failed.")
        self.card_occupied = gauge("card_occupied_share", "Of the card's memory, taken.")
        self.card_queue = gauge("card_queue_seconds", "Age of the oldest frame that waits for the card.")
        self.card_frames = gauge("card_frames", "Frames that the card has drawn.")
        self.card_launches = gauge("card_launches", "Launches that drew them.")
        # Requests.
        self.requests = counter("requests", "Answered requests.", "method", "path", "status")
        self.request_seconds = histogram(
            "request_seconds", "From a request's head to its answer's end.", SECONDS, "path"
        )
        self.clips = gauge("clips", "Clips that are being computed.")
        self.uploads_waiting = gauge("uploads_waiting", "Uploads that wait or run.")
        self.garments = gauge("garments", "Garments in service.")
        # The process.
        still = "For how long the oldest job of a lane has not moved."
        self.lane_still = Gauge("drape_lane_still_seconds", still, ["lane"], registry=registry)
        self.loop_lag = gauge("loop_lag_seconds", "How late the event loop last came round.")
        self.loop_held = histogram(
            "loop_held_seconds", "Steps on the event loop of a millisecond or more.", SECONDS, "cause", "state"
        )
        registry.register(_DroppedLines())

    def watch(self, **gauges: Callable[[], float]) -> None:
        """Makes the gauges of these names read their values from these functions from now on."""
        for name, function in gauges.items():
            getattr(self, name).set_function(function)

    def sent(self, age_s: float, deadline_s: float) -> None:
        """Counts a frame that left ``age_s`` after its pose came."""
        self.frames_sent.inc()
        self.frame_age.observe(age_s)
        if age_s <= deadline_s:
            self.frames_on_time.inc()

    def drawn(self, pushed_share: np.ndarray, push_max_m: np.ndarray, left_m: np.ndarray, resets: np.ndarray) -> None:
        """Counts draped frames by what was done to each; all arrays are (F,)."""
        self.frames.inc(len(pushed_share))
        self.folds_resets.inc(float(resets.sum()))
        for series, values in (
            (self.pushed_share, pushed_share),
            (self.push_max, push_max_m),
            (self.jets_left, left_m),
        ):
            for value in values:
                series.observe(float(value))

    def pieces(self) -> Iterator[bytes]:
        """All series, as ``MEDIA_TYPE``, a family at a time: together they take ten milliseconds."""
        for family in self.registry.collect():
            yield generate_latest(cast("CollectorRegistry", SimpleNamespace(collect=[family].copy)))

    def text(self) -> bytes:
        """All ``pieces`` joined: the page that Prometheus reads."""
        return b"".join(self.pieces())


class _DroppedLines(Collector):
    """The series of lines that the process of the outputs counts."""

    def collect(self) -> list[CounterMetricFamily]:
        what = "Lines of log and output that were dropped: their reader stalled, or the disk was full."
        return [CounterMetricFamily("drape_log_dropped_lines", what, value=dropped_lines())]
