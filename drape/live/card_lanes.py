"""The lanes of all cards of a machine: a stream stays on the card that has its memory, and a new one goes where most
room is."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

from drape.engine.card import DRIVER, Card, count_cards, kernels
from drape.live.card_lane import Asked, Lane, LaneReport


def open_lanes(driver: str = DRIVER) -> Lanes | None:
    """Returns the lanes of this machine's cards; the ``fault`` of one says why it cannot be used. None without the
    extra ``cuda``."""
    path = kernels()
    if path is None:
        return None
    cards = [partial(Card, path, number=number, driver=driver) for number in range(max(count_cards(driver), 1))]
    return Lanes([Lane(card) for card in cards])


class Lanes:
    """The ``lanes`` of cards, one at least. Streams of a card that fails go on by the others, or by the processor."""

    def __init__(self, lanes: Sequence[Lane]) -> None:
        self.lanes = tuple(lanes)

    def close(self) -> None:
        """Ends the threads of all lanes."""
        for lane in self.lanes:
            lane.close()

    @property
    def works(self) -> bool:
        """Whether frames are the cards'."""
        return any(lane.works for lane in self.lanes)

    @property
    def roomiest(self) -> Lane:
        """The lane with the most free memory of those that work."""
        return max(self.lanes, key=lambda lane: (lane.works, lane.free_bytes))

    def of(self, memories: Iterable[Any]) -> Lane:
        """The lane of a stream: where the first of its ``memories`` that are on a card is, if that works."""
        slots = (getattr(memory, "slot", None) for memory in memories)
        own = next((slot.lane for slot in slots if slot is not None and slot.lane.works), None)
        return own or self.roomiest

    def draw(self, jobs: Sequence[tuple[Lane, Asked]]) -> None:
        """Waits until the frames of all ``jobs`` are drawn by their lanes, or these have failed."""
        for lane, job in jobs:
            lane.ask(job)
        for lane, job in jobs:
            lane.wait_for(job)

    def report(self) -> LaneReport:
        """How the lanes do, together: shares in the mean, the oldest frame that waits, and sums."""
        told = [lane.report() for lane in self.lanes]
        return LaneReport(
            card=", ".join(one.card for one in told if one.card),
            fault="; ".join(one.fault for one in told if one.fault),
            occupied=sum(one.occupied for one in told) / len(told),
            busy=sum(one.busy for one in told) / len(told),
            queue_s=max(one.queue_s for one in told),
            frames=sum(one.frames for one in told),
            launches=sum(one.launches for one in told),
        )
