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
    """The series of one service, as attributes. Any thread may call its methods."""

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
        self.frames_sent = counter("frames_sent", "Frames sent to clients of streams.")
        on_time = "Frames sent to clients of streams within DRAPE_FRAME_DEADLINE_S of their pose."
        self.frames_on_time = counter("frames_on_time", on_time)
        age = "Time from the arrival of a pose until its frame is sent."
        self.frame_age = histogram("frame_age_seconds", age, SECONDS)
        acknowledged = "Time from a frame being ready until the client acknowledges it."
        self.ack = histogram("frame_acknowledged_seconds", acknowledged, SECONDS)
        self.batch_frames = histogram("batch_frames", "Frames of streams that are computed together.", FRAMES)
        self.streams = gauge("streams", "Open streams.")
        self.poses_waiting = gauge("poses_waiting", "Streams with a pose that waits for a worker or for credit.")
        self.evictions = counter("evictions", "Streams ended by the service, by kind of refusal.", "kind")
        self.moved = counter("streams_moved", "Streams sent to another process, by whether with their state.", "state")
        brought = "Streams that came from another process with a state, by whether they resumed."
        self.brought = counter("streams_brought", brought, "resumed")
        # The stages of a frame.
        self.stage = histogram("stage_seconds", "Time that one batch takes in a stage.", SECONDS, "stage")
        self.frames = counter("frames", "Frames draped, for streams and clips.")
        self.folds_resets = counter("folds_resets", "Layers whose folds began anew, without the frame before.")
        self.pushed_share = histogram("pushed_share", "Share of a frame's vertices that the push-out moved.", SHARES)
        self.push_max = histogram("push_max_meters", "Farthest that the push-out moved a vertex, by frame.", METRES)
        left = "Most that jets fall short of the push-out of vertices, by frame."
        self.jets_left = histogram("jets_left_meters", left, METRES)
        # A graphics card that computes folds.
        self.card_works = gauge("card_works", "Whether the card computes frames: 1, or 0 once it has failed.")
        self.card_occupied = gauge("card_occupied_share", "Share of the card's memory that is used.")
        self.card_queue = gauge("card_queue_seconds", "Age of the oldest frame that waits for the card.")
        self.card_frames = gauge("card_frames", "Frames that the card has computed.")
        self.card_launches = gauge("card_launches", "Kernel launches that computed these frames.")
        # Requests.
        self.requests = counter("requests", "Answered requests.", "method", "path", "status")
        seconds = "Time from the head of a request to the end of its answer."
        self.request_seconds = histogram("request_seconds", seconds, SECONDS, "path")
        self.clips = gauge("clips", "Clips that are being computed.")
        self.uploads_waiting = gauge("uploads_waiting", "Uploads that wait or run.")
        self.garments = gauge("garments", "Garments in service.")
        # The process.
        still = "Time for which the oldest job of a lane has made no progress."
        self.lane_still = Gauge("drape_lane_still_seconds", still, ["lane"], registry=registry)
        self.loop_lag = gauge("loop_lag_seconds", "How late the last tick of the event loop was.")
        steps = "Duration of steps on the event loop of a millisecond or more."
        self.loop_held = histogram("loop_held_seconds", steps, SECONDS, "cause", "state")
        registry.register(_DroppedLines())

    def watch(self, **gauges: Callable[[], float]) -> None:
        """Makes gauges read their values from functions from now on; the names of ``gauges`` are those of
        attributes."""
        for name, function in gauges.items():
            getattr(self, name).set_function(function)

    def count_sent(self, age_s: float, deadline_s: float) -> None:
        """Counts a frame of a stream that was sent ``age_s`` [s] after its pose came; on time up to ``deadline_s``
        [s]."""
        self.frames_sent.inc()
        self.frame_age.observe(age_s)
        if age_s <= deadline_s:
            self.frames_on_time.inc()

    def count_drawn(
        self, pushed_share: np.ndarray, push_max_m: np.ndarray, left_m: np.ndarray, resets: np.ndarray
    ) -> None:
        """Counts F draped frames. All arrays are (F,): the share of vertices that the push-out moved, in [0, 1]; the
        farthest that it moved one [m]; the most that jets fall short of the push-out of vertices [m]; the number of
        layers whose folds began anew."""
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
        """Yields the text of all series in the format ``MEDIA_TYPE``, one family at a time, because all together take
        ten milliseconds."""
        for family in self.registry.collect():
            yield generate_latest(cast("CollectorRegistry", SimpleNamespace(collect=[family].copy)))

    def text(self) -> bytes:
        """Returns the text of all series in the format ``MEDIA_TYPE``."""
        return b"".join(self.pieces())


class _DroppedLines(Collector):
    """The series of lines that the process of the outputs counts."""

    def collect(self) -> list[CounterMetricFamily]:
        what = "Lines of log and output that were dropped: their reader stalled, or the disk was full."
        return [CounterMetricFamily("drape_log_dropped_lines", what, value=dropped_lines())]
