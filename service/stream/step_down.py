"""When streams step down: to which tier they are held while poses come faster than they can be draped.

Down by one step as soon as a share of the poses was late, that is replaced by newer ones while only the worker was in
the way, and by as many as it takes to spare that share; up again after a while without, where what the next step takes
leaves room, and after twice as long where the last try failed. Nothing is ever computed that was not asked for:
``compute.tiers.capped``. Below the least tier there is what it can spare, ``compute.tiers.spared``, and below that
its folds are carried along.
"""

from __future__ import annotations

import math

WINDOW_S = 0.5  # over which poses are counted
LATE_SHARE = 0.05  # of them that step down
SPARED = 0.125  # of a frame's time by one step, about: 7 to 23 % (docs/reference/performance.md)
CALM_S, CALM_LIMIT_S = 2.0, 64.0  # without late poses before a step up, at first and at most
ROOM = 0.8  # of the time that the worker may be busy after a step up
GUESS = 1.5  # times what a frame takes now, where the next tier has not been measured yet


class StepDown:
    """``level``: the index of the highest tier that streams get; ``top``, how many there are, where nothing holds them.

    Times are seconds of one monotonic clock.
    """

    def __init__(self, top: int, now_s: float) -> None:
        self.top = self.level = top
        self._frame_s: dict[int, float] = {}  # what a frame took, by level
        self._calm_s = CALM_S
        self._raised_s = -math.inf
        self._quiet_since_s = now_s
        self._begin(now_s)

    def _begin(self, now_s: float) -> None:
        self._start_s, self._frames, self._late, self._busy_s = now_s, 0, 0, 0.0

    def hold(self, level: int, now_s: float) -> None:
        """Goes down to ``level``, as if it had stepped there now."""
        if level < self.level:
            self.level = level
            self._quiet_since_s = now_s
            self._begin(now_s)

    def note(self, now_s: float, *, frames: int, late: int, busy_s: float) -> None:
        """Counts ``frames`` that were draped in ``busy_s``, and poses that came too ``late`` since the last call."""
        self._frames += frames
        self._late += late
        self._busy_s += busy_s
        if now_s - self._start_s < WINDOW_S:
            return
        seconds = now_s - self._start_s
        self._frame_s[self.level] = self._busy_s / self._frames
        share = self._late / (self._frames + self._late)
        if share > LATE_SHARE:
            self._quiet_since_s = now_s
            self._down(now_s, max(1, int(share / SPARED)))
        elif self.level < self.top and now_s - self._quiet_since_s >= self._calm_s and self._has_room(seconds):
            self.level += 1
            self._raised_s = self._quiet_since_s = now_s
        self._begin(now_s)

    def _down(self, now_s: float, steps: int) -> None:
        if not self.level:
            return
        self.level = max(0, self.level - steps)
        failed = now_s - self._raised_s < CALM_S
        self._calm_s = min(2.0 * self._calm_s, CALM_LIMIT_S) if failed else CALM_S

    def _has_room(self, seconds: float) -> bool:
        now = self._frame_s[self.level]
        above = self._frame_s.get(self.level + 1, GUESS * now)
        return self._frames * max(above, now) <= ROOM * seconds
