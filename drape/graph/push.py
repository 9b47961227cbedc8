"""The push-out on a processor: ``drape.contact.projection.push_in_parts`` and ``drape.graph.layer_feed``, by the engine
(``drape/engine/source/push.hpp``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.contact.projection import JET_ROUNDS, OTHER_LEAST, TERMS, PushFeed
from drape.contact.push_tables import OTHER_STEPS
from drape.contact.samples import CLUSTER_SIZE
from drape.engine.calls import call, call_with_scratch
from drape.engine.library import empty_points
from drape.graph.layer_feed import REGION_ROW, LayerFeed

_LOGITS = np.log(np.arange(OTHER_STEPS + 1) / OTHER_STEPS + OTHER_LEAST)  # by how much a sample is another part


@dataclass(frozen=True, eq=False)
class PushConstants:
    """The constants with which the engine pushes a garment: its ``feed`` as contiguous arrays, and ``logits`` (256,),
    the logit of a sample by how much it belongs to another part, in 255ths.

    A garment over others also has the ``region``, ``cloth_member`` and ``cloth_rows`` of a ``LayerFeed``; these are
    empty otherwise.
    """

    feed: PushFeed
    logits: np.ndarray
    region: np.ndarray
    cloth_member: np.ndarray
    cloth_rows: np.ndarray

    @classmethod
    def of(cls, feed: PushFeed | LayerFeed) -> PushConstants:
        """Returns the engine's constants for ``feed``."""
        push = (feed.push if isinstance(feed, LayerFeed) else feed).each(np.ascontiguousarray)
        logits, none = _LOGITS.astype(push.patch_fit.dtype), np.empty(0, np.int32)
        if not isinstance(feed, LayerFeed):
            return cls(push, logits, none, none, none)
        return cls(push, logits, feed.region.reshape(-1), feed.cloth_member, feed.cloth_rows)

    @property
    def bytes(self) -> int:
        """The memory of all arrays, in bytes."""
        return sum(one.nbytes for one in (*self.feed.flat().values(), self.region, self.cloth_member, self.cloth_rows))


def push_frames(
    vertices: np.ndarray,
    skin: np.ndarray,
    constants: PushConstants,
    clearance_m: float,
    *,
    under: np.ndarray | None = None,
    jets: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Returns for F frames the pushed vertices [m] (F, V, 3), how far [m] (F, V) each was moved, and ``coefficients``
    (F, K, 3, 10) and ``left_m`` (F,) of ``Pushed``. The last two hold only with ``jets``.

    ``vertices`` [m] (F, V, 3) are pushed out of the bodies with the samples ``skin`` (F, R, 12, 8), up to
    ``clearance_m`` [m] off them. A garment over others is pushed out of these too; ``under`` [m] (F, U, 3) are their
    pushed vertices.
    """
    kind, (frames, count) = constants.feed.patch_fit.dtype, vertices.shape[:2]
    pushed, way = np.empty((frames, count, 3), kind), np.empty((frames, count), kind)
    coefficients, left_m = np.empty((frames, constants.feed.patches, 3, TERMS), kind), np.empty(frames, kind)
    given, rounds = empty_points(count, kind), JET_ROUNDS if jets else 1
    for i in range(frames):
        given[:] = vertices[i]
        samples = np.ascontiguousarray(skin[i], kind).reshape(-1, REGION_ROW)
        if under is not None:
            samples = np.concatenate([samples, _cloth(np.ascontiguousarray(under[i], kind), constants)])
            samples = samples.take(constants.region, axis=0)
        found = pushed[i], way[i], coefficients[i], left_m[i : i + 1]
        given_all = given, samples, constants.feed, constants.logits, float(clearance_m), rounds
        call_with_scratch("push_out", kind, *given_all, *found)
    return pushed, way, coefficients, left_m


def _cloth(under: np.ndarray, constants: PushConstants) -> np.ndarray:
    """The regions (n, 96) of samples on the garments draped to ``under`` [m] (U, 3)."""
    clusters = constants.cloth_member.size // constants.cloth_member.shape[-1]
    samples = np.empty((clusters * CLUSTER_SIZE * 8 // REGION_ROW, REGION_ROW), under.dtype)
    call("pose_cloth", under.dtype, under, constants.cloth_member, constants.cloth_rows, clusters, samples)
    return samples
