"""Chooses the replica for a request, and tells each replica which replicas serve: the ``Router`` of
``service.ray_app``.

Ray tells a replica that it must leave only when its requests have ended, and streams do not end. Routers are told at
once, in the proxy as in every process that calls replicas, so each replica has one.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

# Functions of this process that take the ids of the replicas that serve, when these change. Any thread may call them.
WATCHERS: list[Callable[[frozenset[str]], object]] = []


class RouterRules:
    """The part of ``Router`` that differs from Ray's own: a request goes to the replica with the fewest streams and
    requests, and ``WATCHERS`` are called when the set of replicas that serve changes."""

    async def choose_replicas(self, candidate_replicas: list[Any], pending_request: Any = None) -> list[list[Any]]:
        """Returns all ``candidate_replicas`` as one rank, in random order. Ray takes the one with the fewest requests
        of a rank, and the first of equals."""
        return [random.sample(candidate_replicas, len(candidate_replicas))]

    def update_replicas(self, replicas: list[Any]) -> None:
        """Takes the ``replicas`` that serve from now on, and calls ``WATCHERS`` with their ids."""
        super().update_replicas(replicas)  # pyright: ignore[reportAttributeAccessIssue]
        _tell(frozenset(replica.replica_id.unique_id for replica in replicas))


def _tell(replicas: frozenset[str]) -> None:
    # Ray sends ``Router`` and all that it names as copies. So the list of this process is imported here.
    from service.replicas.ray_router import WATCHERS as watchers

    for watcher in watchers:
        watcher(replicas)


def __getattr__(name: str) -> type:
    """Returns ``Router``, which is made when Ray asks for it, so that this module can be imported without Ray."""
    if name != "Router":
        raise AttributeError(name)
    from ray.serve.request_router import FIFOMixin, RequestRouter  # pyright: ignore[reportMissingImports]

    members = {"__module__": __name__, "__doc__": RouterRules.__doc__}
    router = globals()[name] = type(name, (RouterRules, FIFOMixin, RequestRouter), members)
    return router
