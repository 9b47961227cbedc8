"""Chooses the number of replicas from the ages of frames: ``FrameAges`` measures them, ``wanted_replicas`` decides."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from prometheus_client import Histogram

WINDOW_S = 5.0  # the time over which ages of frames count
SPARE = 0.75  # the share of the deadline below which ages must stay where one replica fewer serves
PERCENTILE = 0.99
AGE, STREAMS = "frame_age_p99_s", "streams"  # the names of a replica's loads in Ray's autoscaler


@dataclass(frozen=True)
class Load:
    """The load of one replica: ``age_s``, the 99th percentile of its frames' ages [s], 0 without frames, and its number
    of streams."""

    age_s: float
    streams: int


class FrameAges:
    """Computes the 99th percentile of the ages of frames in the last ``WINDOW_S`` from ``histogram``, which counts them
    [s] since the start."""

    def __init__(self, histogram: Histogram) -> None:
        self._histogram = histogram
        self._seen: deque[tuple[float, np.ndarray]] = deque()

    def p99_s(self, now_s: float | None = None) -> float:
        """Returns the 99th percentile of the ages [s], interpolated linearly within its bucket and at most the last
        finite bound; 0 if no frame was sent. ``now_s`` [s, monotonic] is the current time by default."""
        now = time.monotonic() if now_s is None else now_s
        bounds, counts = self._counts()
        self._seen.append((now, counts))
        while len(self._seen) > 1 and self._seen[1][0] <= now - WINDOW_S:
            self._seen.popleft()
        fresh = counts - self._seen[0][1]
        if fresh[-1] <= 0:
            return 0.0
        bucket = int(np.searchsorted(fresh, rank := PERCENTILE * fresh[-1]))
        below, above = (0.0, *bounds)[bucket], bounds[bucket]
        if not np.isfinite(above):
            return below
        before = fresh[bucket - 1] if bucket else 0.0
        return float(below + (above - below) * (rank - before) / (fresh[bucket] - before))

    def _counts(self) -> tuple[list[float], np.ndarray]:
        """Returns the upper bounds [s] of the buckets (B), and how many ages since the start are at or below each,
        (B,)."""
        samples = (sample for series in self._histogram.collect() for sample in series.samples)
        buckets = [sample for sample in samples if sample.name.endswith("_bucket")]
        return [float(bucket.labels["le"]) for bucket in buckets], np.array([bucket.value for bucket in buckets])


def wanted_replicas(loads: Mapping[str, Load], deadline_s: float) -> int:
    """Returns how many replicas should serve ``loads``, which has the load of each of the replicas that serve now.

    It is one more where a replica has late frames (above ``deadline_s`` [s]) and more than one stream, so that another
    can take some. It is one less where a replica has no stream, or where the sum of ages, spread over the others, stays
    below ``SPARE`` of the deadline: streams that share a thread wait for each other, so ages add.
    """
    count = len(loads)
    if any(load.age_s > deadline_s and load.streams > 1 for load in loads.values()):
        return count + 1
    if count == 1:
        return count
    idle = any(load.streams == 0 for load in loads.values())
    spread_s = sum(load.age_s for load in loads.values()) / (count - 1)
    return count - 1 if idle or spread_s <= SPARE * deadline_s else count


class Policy:
    """A policy of Ray's autoscaler. Called with its context, it returns ``wanted_replicas`` of the loads that running
    replicas report. ``deadline_s`` [s] is the age above which a frame is late."""

    def __init__(self, deadline_s: float) -> None:
        self._deadline_s = deadline_s

    def __call__(self, ctx: Any) -> tuple[int, dict[str, Any]]:
        """Returns the number of replicas for an ``AutoscalingContext``, and an empty state. The number stays while
        replicas come or go, or have not reported their load. Ray keeps it within its bounds and applies its delays."""
        ages, streams = ((ctx.aggregated_metrics or {}).get(name, {}) for name in (AGE, STREAMS))
        loads = {
            str(replica): Load(ages[replica], round(streams.get(replica, 0.0)))
            for replica in ctx.running_replicas
            if replica in ages
        }
        if not loads or len(loads) != ctx.target_num_replicas:
            return ctx.target_num_replicas, {}
        return wanted_replicas(loads, self._deadline_s), {}
