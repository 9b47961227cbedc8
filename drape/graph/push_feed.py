"""A garment's constants for the push-out, laid out as ``drape.contact.projection`` and its graph take them."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np

from drape.arrays import Array, namespace
from drape.body.model import BodyModel
from drape.contact.projection import CHARTS_PER_VERTEX, TERMS, TILE_WIDTH, PushFeed
from drape.contact.push_tables import BLOCK_SIZE, PushTables, push_tables
from drape.contact.samples import Samples
from drape.contact.skin import body_skin, shaped_skin
from drape.errors import ArtifactError
from drape.garment.cache import Garment
from drape.geometry import jets
from drape.graph.feeds import garment_feed
from drape.graph.packing import tile_charts

KEPT_SHAPES = 64
RIDGE = 1e-3  # share of the mean square of a patch's basis: few vertices do not determine a cubic


def pack_push(
    feed: dict[str, np.ndarray], vertices: np.ndarray, skin: Samples, *, hidden: np.ndarray | None = None
) -> PushFeed:
    """Returns the push-out's constants for the garment with the ``garment_feed`` ``feed``, as numpy arrays.

    ``vertices`` [m] (V, 3) are its vertices at rest, as many as ``feed`` has, on the body with the samples ``skin``;
    ``hidden`` (S,) bool are samples under cloth, which push nothing. Raises ``ArtifactError`` for another number of
    vertices.
    """
    count = len(feed["chart_patch"])
    if len(vertices) != count:
        raise ArtifactError(
            "vertices",
            expected=f"{count}, as in the feed",
            got=str(len(vertices)),
            cure="Pass the feed's own vertices.",
        )
    tables = push_tables(vertices, skin, hidden=hidden)
    return PushFeed(**vars(tables), **_of_charts(feed, tables))


class SkinShapes:
    """The skin samples of ``body`` in any shape. The ``KEPT_SHAPES`` shapes used last are kept; each takes a
    megabyte."""

    def __init__(self, body: BodyModel) -> None:
        self._skin = shaped_skin(body)
        self._kept: OrderedDict[bytes, np.ndarray] = OrderedDict()

    @property
    def counts(self) -> np.ndarray:
        """How many bones move the skin of each of P parts, (P,)."""
        return self._skin.counts

    def feed(self, betas: np.ndarray) -> dict[str, np.ndarray]:
        """Returns the inputs of the packed graph for the skins of B bodies with the shapes ``betas`` (B, 10), U
        different ones: ``skin_rows`` (U, P, n, 4, 144) float32, ``skin_bones`` (P, n) and ``body_shape`` (B,), the row
        of each body's shape."""
        if len(betas) == 1:  # most frames of a stream
            rows = self._rows(np.asarray(betas, np.float32).tobytes())[None]
            return {"skin_rows": rows, "skin_bones": self._skin.bones, "body_shape": np.zeros(1, np.int32)}
        keys = [row.tobytes() for row in np.ascontiguousarray(betas, dtype=np.float32)]
        shapes = {key: i for i, key in enumerate(dict.fromkeys(keys))}
        rows = [self._rows(key) for key in shapes]
        return {
            "skin_rows": rows[0][None] if len(rows) == 1 else np.stack(rows),
            "skin_bones": self._skin.bones,
            "body_shape": np.array([shapes[key] for key in keys], dtype=np.int32),
        }

    def _rows(self, key: bytes) -> np.ndarray:
        if key not in self._kept:
            self._kept[key] = np.ascontiguousarray(self._skin.of(np.frombuffer(key, dtype=np.float32)[None])[0])
            if len(self._kept) > KEPT_SHAPES:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]


def push_feed(garment: Garment, body: BodyModel) -> PushFeed:
    """Returns the push-out's constants for all vertices of the fine mesh of ``garment``, on ``body``."""
    return pack_push(garment_feed(garment, fine=True), garment.vertices, body_skin(body))


def pushed_jets(jet: Array, rotation: Array, scale: Array, coefficients: Array) -> Array:
    """Returns a stream's jets (F, K, 45), in patch scales and in the patches' frames, with the push-out added to them.

    ``jet`` (F, K, 27 or 45) and the frames' ``rotation`` (F, K, 3, 3) are the drape's, ``scale`` [m] (K,) is the
    patches'. ``coefficients`` [m] (F, K, 3, 10) are those of ``drape.contact.projection.Pushed``. A cubic is part of a
    full jet of order 4, so the sum is exact.
    """
    xp = namespace(jet)
    local = (xp.matrix_transpose(rotation) @ coefficients) / scale[:, None, None]
    missing = xp.zeros_like(jet[..., None, : jets.HEIGHT_COUNT - TERMS])
    padded = xp.concat([local, xp.concat([missing] * 3, axis=-2)], axis=-1)
    return jets.full(jet) + xp.reshape(padded, (*jet.shape[:-1], jets.FULL_COUNT))


def _of_charts(feed: dict[str, np.ndarray], tables: PushTables) -> dict[str, np.ndarray]:
    patches = len(feed["patch_scale"])
    tiling = tile_charts(feed["chart_patch"], patches, width=TILE_WIDTH)
    weight = feed["chart_weight"].astype(np.float64)[..., None]
    basis = feed["chart_basis"].astype(np.float64)[..., :TERMS]
    charts = tiling.column[tables.block_vertex.reshape(-1)].astype(np.int32)
    members = tables.block_vertex.reshape(-1, BLOCK_SIZE)
    block, fit = _fits(feed["chart_patch"][members], weight[members], basis[members], patches)
    return {
        "patch_block": block,
        "patch_fit": fit,
        "tile_basis": tiling.lay(weight * basis),
        "tile_patch": tiling.patch,
        "slot_charts": np.ascontiguousarray(charts.T).reshape(CHARTS_PER_VERTEX, len(tables.region_bias), -1),
    }


def _fits(
    chart_patch: np.ndarray, weight: np.ndarray, basis: np.ndarray, patches: int
) -> tuple[np.ndarray, np.ndarray]:
    """Blocks (K, B) of each patch, and the weights (K, B, 10) of the least squares over their mean places.

    From the charts (C, 16, 4), (C, 16, 4, 1), (C, 16, 4, 10) of the blocks' vertices.
    """
    count = len(chart_patch)
    key = (chart_patch * count + np.arange(count)[:, None, None]).reshape(-1)  # patch and block
    pair, inverse = np.unique(key, return_inverse=True)
    share = np.bincount(inverse, weight.reshape(-1))
    moments = [np.bincount(inverse, (weight * basis)[..., term].reshape(-1)) for term in range(TERMS)]
    pair, share, moments = pair[share > 0.0], share[share > 0.0], np.stack(moments, axis=1)[share > 0.0]
    place = moments / share[:, None]
    patch = pair // count
    normal = np.zeros((patches, TERMS, TERMS))
    np.add.at(normal, patch, share[:, None, None] * place[:, :, None] * place[:, None, :])
    ridge = RIDGE * np.trace(normal, axis1=1, axis2=2) / TERMS + 1e-12
    inverses = np.linalg.inv(normal + ridge[:, None, None] * np.eye(TERMS))
    weights = np.einsum("nij,nj->ni", inverses[patch], share[:, None] * place)
    rank = np.arange(len(pair)) - np.searchsorted(patch, patch)
    block = np.zeros((patches, int(rank.max()) + 1), dtype=np.int32)
    fit = np.zeros((*block.shape, TERMS), dtype=np.float32)
    block[patch, rank], fit[patch, rank] = pair % count, weights
    return block, fit
