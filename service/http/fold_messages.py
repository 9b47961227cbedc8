"""Makes FOLDS messages, each of which takes a second, and the keys under which they are kept."""

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
KEPT = 8  # the most messages in memory, of some 1.5 MB compressed


def queried_fabric(text: str | None) -> FabricChoice | None:
    """Returns the fabric in a query: its numbers if ``text`` is a JSON object, else ``text`` as its name; None for no
    text. Refuses (``InputError``) an object with other fields."""
    if not text:
        return None
    if not text.startswith("{"):
        return text
    return validate_document(FabricNumbers, read_document(text.encode(), source=FABRIC), source=FABRIC)


def pack_message(
    worn: Garment, body: BodyModel, fabric: Fabric | None, shape: np.ndarray, coarse: bool, hung: Drawer | None
) -> bytes:
    """Returns the bytes of the FOLDS message of the garment ``worn`` on ``body`` in ``shape`` (S,), compressed by
    ``packed_text``.

    ``fabric``: None for the garment's own. ``coarse``: whether a coarse cloth takes the steps of folds. ``hung``: the
    drawn mesh that hangs on the cloth, if the message shall hold it too.
    """
    records = flat_records(fold_records(worn, body, fabric, shape, coarse=coarse))
    return packed_text(pack_folds(*(records if hung is None else with_hung(*records, hung.arrays()))))


def message_key(
    worn: Garment, body: BodyModel, fabric: Fabric | None, shape: np.ndarray, coarse: bool, hung: Drawer | None
) -> bytes:
    """Returns a key for the message that ``pack_message`` makes of the same arguments: different messages have
    different keys."""
    cloth = "" if fabric is None else fabric.digest
    names = (str(WIRE_VERSION), f"{HASH:x}", worn.digest, body.digest, cloth, str(coarse), "hung" * (hung is not None))
    return "|".join(names).encode() + shape.tobytes()
