"""The stages of one body, and the garments whose constants they have."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from drape.body.model import BodyModel
from drape.garment.cache import Garment
from drape.graph.feeds import garment_feed
from drape.stages.scene import Entry
from drape.stages.stage import Make, Stage, call_here


class BodyStages:
    """The ``stages`` that drape on ``body``. ``make(function, *arguments)`` calls a function that takes long."""

    def __init__(self, body: BodyModel, stages: Sequence[Stage] = (), make: Make = call_here) -> None:
        self.body, self.stages, self._make = body, tuple(stages), make
        self._known: set[str] = set()

    def feed(self, garment: Garment) -> dict[str, np.ndarray]:
        """Returns ``garment_feed`` of ``garment`` on the body: arrays by name. Any thread may call it."""
        return self._make(garment_feed, garment, body=self.body)

    def add(self, garment: Garment, feed: dict[str, np.ndarray]) -> None:
        """Lets every stage store ``garment``; ``feed`` is what ``feed(garment)`` returned. One thread at a time may
        call it."""
        for stage in self.stages:
            stage.add(garment, feed)
        self._known.add(garment.digest)

    def missing(self, entries: Iterable[Entry]) -> list[Garment]:
        """Returns the garments of ``entries`` that were not added yet, each once, such as a subdivided mesh at its
        first request."""
        worn = {entry.garment.digest: entry.garment for entry in entries}
        return [garment for digest, garment in worn.items() if digest not in self._known]

    def remove(self, garment: Garment) -> None:
        """Makes every stage forget ``garment``, if it was added."""
        if garment.digest in self._known:
            self._known.discard(garment.digest)
            for stage in self.stages:
                stage.remove(garment)
