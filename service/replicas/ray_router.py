"""Which replica takes a request, and who hears which replicas serve: the ``Router`` of ``service.ray_app``.

Ray tells a replica that it leaves only when all it had is through, and streams have no end. Routers hear of it at once,
in the proxy as in every process that calls replicas, so each replica has one.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

WATCHERS: list[Callable[[frozenset[str]], object]] = []  # of this process, told from any thread


class Watching:
    """The rules of ``Router`` beside Ray's: the replica with the fewest streams and requests takes the next, and
    this process hears which replicas serve."""

    async def choose_replicas(self, candidate_replicas: list[Any], pending_request: Any = None) -> list[list[Any]]:
        """All ``candidate_replicas`` as one rank, of which Ray takes the one with the fewest, the first of several."""
        return [random.sample(candidate_replicas, len(candidate_replicas))]

    def update_replicas(self, replicas: list[Any]) -> None:
        """Takes the replicas that serve from now on, and tells the application of this process, if it has one."""
        super().update_replicas(replicas)  # pyright: ignore[reportAttributeAccessIssue]
        _tell(frozenset(replica.replica_id.unique_id for replica in replicas))


def _tell(replicas: frozenset[str]) -> None:
    from service.replicas.ray_router import (
        WATCHERS as told,  # Ray sends ``Router`` and all it names as a copy, this list too
    )

    for watcher in told:
        watcher(replicas)


def __getattr__(name: str) -> type:
    """``Router``, made when Ray asks for it, so that this module can be read without Ray."""
    if name != "Router":
        raise AttributeError(name)
    from ray.serve.request_router import FIFOMixin, RequestRouter  # pyright: ignore[reportMissingImports]

    made = type(name, (Watching, FIFOMixin, RequestRouter), {"__module__": __name__, "__doc__": Watching.__doc__})
    globals()[name] = made
    return made
