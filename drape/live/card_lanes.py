"""The lanes of all cards of a machine: a stream stays on the card that has its memory, and a new one goes where most
room is."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

from drape.engine.card import DRIVER, Card, count_cards, kernels
from drape.live.card_lane import Lane, LaneJob, LaneReport


def open_lanes(driver: str = DRIVER) -> Lanes | None:
    """Returns the lanes of this machine's cards, at least one; the ``fault`` of a lane says why its card cannot be
    used. None without the extra ``cuda``."""
    path = kernels()
    if path is None:
        return None
    cards = [partial(Card, path, number=number, driver=driver) for number in range(max(count_cards(driver), 1))]
    return Lanes([Lane(card) for card in cards])


class Lanes:
    """The ``lanes`` of all cards, at least one. Streams of a card that fails go on by another one, or by the
    processor."""

    def __init__(self, lanes: Sequence[Lane]) -> None:
        self.lanes = tuple(lanes)

    def close(self) -> None:
        """Ends the threads of all lanes, once all that waits is drawn."""
        for lane in self.lanes:
            lane.close()

    @property
    def works(self) -> bool:
        """Whether any card draws frames."""
        return any(lane.works for lane in self.lanes)

    @property
    def roomiest(self) -> Lane:
        """The lane with the most free memory among those that work; any lane if none does."""
        return max(self.lanes, key=lambda lane: (lane.works, lane.free_bytes))

    def of(self, memories: Iterable[Any]) -> Lane:
        """Returns the lane for a stream with these ``memories``: the one of the first memory on a card, if it works,
        else the roomiest."""
        slots = (getattr(memory, "slot", None) for memory in memories)
        own = next((slot.lane for slot in slots if slot is not None and slot.lane.works), None)
        return own or self.roomiest

    def draw(self, jobs: Sequence[tuple[Lane, LaneJob]]) -> None:
        """Asks each lane for its job, and waits until all ``jobs`` are drawn or their cards have failed."""
        for lane, job in jobs:
            lane.ask(job)
        for lane, job in jobs:
            lane.wait_for(job)

    def report(self) -> LaneReport:
        """Returns the state of all lanes as one: mean shares, the age of the oldest frame that waits, and sums of the
        counts."""
        reports = [lane.report() for lane in self.lanes]
        return LaneReport(
            card=", ".join(report.card for report in reports if report.card),
            fault="; ".join(report.fault for report in reports if report.fault),
            occupied=sum(report.occupied for report in reports) / len(reports),
            busy=sum(report.busy for report in reports) / len(reports),
            queue_s=max(report.queue_s for report in reports),
            frames=sum(report.frames for report in reports),
            launches=sum(report.launches for report in reports),
        )
