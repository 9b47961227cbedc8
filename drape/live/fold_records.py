"""The records by which a client folds and swings a garment by itself (``drape.wire.folds_message``)."""

from __future__ import annotations

from typing import Any

import numpy as np

from drape.body.feed import BodyFeed
from drape.body.model import BodyModel
from drape.cloth.fabric import Fabric
from drape.contact.skin import body_skin
from drape.garment.cache import Garment
from drape.graph.feeds import shape_numbers
from drape.live.fold_constants import fold_constants
from drape.live.swing_constants import swing_constants
from drape.live.two_level import two_level


def fold_records(
    garment: Garment, body: BodyModel, fabric: Fabric | None, betas: np.ndarray, *, coarse: bool
) -> dict[str, Any]:
    """Returns the records by which a client folds ``garment`` on ``body`` in the shape ``betas`` (S,), made of
    ``fabric`` or else its own, by their names in the engine: "Levels" if a ``coarse`` cloth takes the steps, else
    "FoldConstants"; "SwingConstants", if anything swings; and "BodyFeed".

    Raises ``BodyError`` for a body with pose blend shapes.
    """
    feed = shape_feed(body, betas)
    if coarse:
        records: dict[str, Any] = {"Levels": two_level(garment, body, fabric).levels}
    else:
        records = {"FoldConstants": fold_constants(garment, body, fabric)}
    swing = swing_constants(garment, body, fabric)
    return records | ({} if swing is None else {"SwingConstants": swing}) | {"BodyFeed": feed}


def shape_feed(body: BodyModel, betas: np.ndarray | None = None) -> BodyFeed:
    """Returns the constants by which the engine poses ``body`` in the shape ``betas`` (S,); None is the mean shape.

    The fields of ``BodyFeed`` that change from frame to frame are empty arrays (0,): ``local``, the rotations of the
    pose, and ``motion``, the code of the motion. Raises ``BodyError`` for a body with pose blend shapes.
    """
    skin, none = body_skin(body).on_bones(body, betas), np.zeros(0, np.float32)
    rows = np.asarray(skin.rows)
    counts, rest, shape = rows.any(axis=(2, 3)).sum(axis=1), body.rest_joints(betas), shape_numbers(body, betas)
    return BodyFeed(none, rest, shape, none, rows, np.asarray(skin.bones), counts)
