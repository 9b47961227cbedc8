"""The number of processes that streams need: ``FrameAges`` measures how old frames are, ``wanted_replicas`` decides."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from prometheus_client import Histogram

WINDOW_S = 5.0
SPARE = 0.75  # of the deadline: a replica goes only where the others would stay below it
PERCENTILE = 0.99
AGE, STREAMS = "frame_age_p99_s", "streams"  # what a replica tells the autoscaler


@dataclass(frozen=True)
class Load:
    """The load of one replica: the 99th percentile of its frames' ages [s], 0 without frames, and how many streams."""

    age_s: float
    streams: int


class FrameAges:
    """The 99th percentile of the frame ages that a histogram took in during the last ``WINDOW_S``."""

    def __init__(self, histogram: Histogram) -> None:
        self._histogram = histogram
        self._seen: deque[tuple[float, np.ndarray]] = deque()

    def p99_s(self, now_s: float | None = None) -> float:
        """Returns the 99th percentile [s] of the ages, linear within its bucket and never above the last bound; 0 if no
        frame left."""
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
        """Upper bounds [s] of the buckets, and how many ages so far lie at or below each."""
        found = (one for series in self._histogram.collect() for one in series.samples)
        samples = [one for one in found if one.name.endswith("_bucket")]
        return [float(one.labels["le"]) for one in samples], np.array([one.value for one in samples])


def wanted_replicas(loads: Mapping[str, Load], deadline_s: float) -> int:
    """The number of replicas that should serve the ``loads`` (by replica, at least one).

    One more where a replica has late frames and more than one stream, so that another can take some. One less where a
    replica has no stream, or where the ages, added up and spread over the others, stay below ``SPARE`` of
    ``deadline_s``: streams that share a thread wait for each other, so ages add. The number stays otherwise.
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
    """How many replicas Ray's autoscaler asks for: ``wanted_replicas`` of what running ones tell of their load.

    ``deadline_s`` [s] is that of ``DRAPE_FRAME_DEADLINE_S``.
    """

    def __init__(self, deadline_s: float) -> None:
        self._deadline_s = deadline_s

    def __call__(self, ctx: Any) -> tuple[int, dict[str, Any]]:
        """The number of replicas that ``wanted_replicas`` names for an ``AutoscalingContext``; the one of now
        while replicas come or go, or have not told their load yet. Ray keeps it within the bounds and waits."""
        ages, streams = ((ctx.aggregated_metrics or {}).get(name, {}) for name in (AGE, STREAMS))
        loads = {str(one): Load(ages[one], round(streams.get(one, 0.0))) for one in ctx.running_replicas if one in ages}
        if not loads or len(loads) != ctx.target_num_replicas:
            return ctx.target_num_replicas, {}
        return wanted_replicas(loads, self._deadline_s), {}
