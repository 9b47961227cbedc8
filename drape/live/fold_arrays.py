"""The constants of folds as flat arrays by name, for clients that make the folds (``drape.wire.folds``)."""

from __future__ import annotations

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import PARENTS
from drape.contact.skin import SkinOnBones, body_skin
from drape.live.fold_constants import FoldConstants
from drape.wire.folds import NUMBERS


def fold_arrays(constants: FoldConstants) -> dict[str, np.ndarray]:
    """The arrays of ``constants``: the cloth's tables, the factor, the skin's graph, and which triangles may cross."""
    sheet, factor, near, tangles = constants.sheet, constants.factor, constants.neighbours, constants.tangles
    creases = {name: getattr(sheet.creases, name) for name in ("corner", "stiffness", "cosine", "sine")}
    entries = {name: getattr(sheet, f"crease_{name}") for name in ("start", "lane", "member")}
    tables = ("vertex", "place", "fan_start", "fan_other", "fan_slope", "bend_start", "bend_other", "bend_value", "own")
    return {
        "numbers": np.array([*(getattr(sheet.constants, name) for name in NUMBERS[:-1]), constants.friction]),
        **{name: getattr(sheet, name) for name in tables},
        **{f"crease_{name}": array for name, array in (creases | entries).items()},
        **{f"factor_{name}": array for name, array in factor._asdict().items()},
        **constants.graph._asdict(),
        **{f"near_{name}": getattr(near, name) for name in ("start", "vertex", "square")},
        **{name: getattr(near, name) for name in ("clusters", "other_start", "other", "bound")},
        "index": constants.index,
        "hem": constants.hem,
        **{f"tangle_{name}": array for name, array in tangles._asdict().items()},
    }


def body_arrays(body: BodyModel, betas: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """What poses the skin's samples of ``body`` in the shape ``betas``: their sums over bones, and the rest joints.

    Refuses (``BodyError``) a body with pose blend shapes.
    """
    return posed_by(body_skin(body).on_bones(body, betas), body.rest_joints(betas))


def posed_by(skin: SkinOnBones, joints: np.ndarray) -> dict[str, np.ndarray]:
    """``skin`` and the rest ``joints`` [m] (24, 3) as arrays."""
    return {
        "skin_bones": np.asarray(skin.bones),
        "skin_rows": np.asarray(skin.rows),
        "joints": joints,
        "parents": np.array(PARENTS),
    }
