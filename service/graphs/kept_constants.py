"""Constants that are made once and kept while they are used: ``KeptConstants``."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterator
from typing import Generic, TypeVar

Constants = TypeVar("Constants")
Key = tuple[str, ...]  # digests of garments and of a fabric


class KeptConstants(Generic[Constants]):
    """Constants by their keys; the longest unused ones go while there are ``too_many``.

    One thread makes constants at a time. A thread whose constants are there does not wait for it.
    """

    def __init__(self, too_many: Callable[[Collection[Constants]], bool] = lambda kept: False) -> None:
        self._kept: OrderedDict[Key, Constants] = OrderedDict()
        self._too_many = too_many
        self._looking, self._making = threading.Lock(), threading.Lock()

    def get(self, key: Key, make: Callable[[], Constants]) -> Constants:
        """The constants under ``key``, made by ``make`` where they are missing."""
        found = self._find(key)
        if found is None:
            with self._making:
                found = self._find(key)
                if found is None:
                    found = (make(),)
                    self._keep(key, found[0])
        return found[0]

    def forget(self, digest: str) -> None:
        """Drops all constants whose key has ``digest``."""
        with self._looking:
            for key in [key for key in self._kept if digest in key]:
                del self._kept[key]

    def __iter__(self) -> Iterator[Key]:
        return iter(tuple(self._kept))

    def _find(self, key: Key) -> tuple[Constants] | None:
        """The constants under ``key`` in a tuple, since they may be None themselves."""
        with self._looking:
            if key not in self._kept:
                return None
            self._kept.move_to_end(key)
            return (self._kept[key],)

    def _keep(self, key: Key, made: Constants) -> None:
        with self._looking:
            self._kept[key] = made
            while len(self._kept) > 1 and self._too_many(self._kept.values()):
                self._kept.popitem(last=False)
