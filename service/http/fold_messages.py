"""FOLDS messages, which take a second to make."""

from __future__ import annotations

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.fabric import Fabric
from drape.engine.flat_records import flat_records
from drape.engine.records import HASH
from drape.garment.bound import Drawer
from drape.garment.cache import Garment
from drape.live.fold_records import fold_records
from drape.wire.folds_message import pack_folds, with_hung
from drape.wire.messages import WIRE_VERSION
from drape.wire.options import FabricChoice, FabricNumbers
from service.http.json_body import read_document, validate_document
from service.http.kept import packed_text
from service.http.problems import JsonSource

FABRIC = JsonSource("fabric", "Send a fabric's name, or its numbers as a JSON object.")
KEPT = 8  # messages of some 3 MB, compressed to half of their size
Folded = tuple[Garment, BodyModel, Fabric | None, np.ndarray, bool, Drawer | None]


def queried_fabric(text: str | None) -> FabricChoice | None:
    """Returns the fabric in a query: a name, or numbers if ``text`` is a JSON object; None if there is none. Refuses
    other JSON."""
    if not text:
        return None
    if not text.startswith("{"):
        return text
    return validate_document(FabricNumbers, read_document(text.encode(), source=FABRIC), source=FABRIC)


def pack_message(
    worn: Garment, body: BodyModel, fabric: Fabric | None, shape: np.ndarray, coarse: bool, hung: Drawer | None
) -> bytes:
    """Returns the compressed FOLDS message of the garment ``worn`` on ``body`` in ``shape``, made of ``fabric`` or else
    its own.

    ``coarse``: whether a coarse cloth takes the steps. ``hung``: whether the message also has the mesh that hangs on
    the cloth.
    """
    told = flat_records(fold_records(worn, body, fabric, shape, coarse=coarse))
    return packed_text(pack_folds(*(told if hung is None else with_hung(*told, hung.arrays()))))


def message_key(
    worn: Garment, body: BodyModel, fabric: Fabric | None, shape: np.ndarray, coarse: bool, hung: Drawer | None
) -> bytes:
    """Returns all that a message of ``pack_message`` depends on, as bytes: equal bytes, equal messages."""
    named = "" if fabric is None else fabric.digest
    said = "|".join(
        (str(WIRE_VERSION), f"{HASH:x}", worn.digest, body.digest, named, str(coarse), "hung" * (hung is not None))
    )
    return said.encode() + shape.tobytes()
