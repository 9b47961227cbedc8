"""Records as a document and flat arrays: what a client lays into the memory of an engine of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from drape.engine import packer
from drape.engine.records import HASH, RECORDS

TYPES = packer.TYPES | {"numbers": np.dtype(np.float32)}


def flat_records(values: Mapping[str, Any]) -> tuple[dict[str, Any], list[np.ndarray]]:
    """Returns the records ``values``, by their names in ``RECORDS``, as a document for JSON and a list of flat arrays.

    The document's ``layout`` is the table's ``HASH``. Its ``records`` has the fields of each record by name: a number;
    of an array the count of its elements; of a record its fields in the same way; of several records a list. Arrays
    come in the order of the table's fields; their floats are float32.
    """
    arrays: list[np.ndarray] = []
    records = {name: _document(name, value, arrays) for name, value in values.items()}
    return {"layout": f"{HASH:016x}", "records": records}, arrays


def _document(name: str, value: Any, arrays: list[np.ndarray]) -> dict[str, Any]:
    document: dict[str, Any] = {}
    for field, kind in RECORDS[name].items():
        own = getattr(value, field)
        if kind in RECORDS:
            document[field] = _document(kind, own, arrays)
        elif kind.endswith("[]"):
            document[field] = [_document(kind[:-2], one, arrays) for one in own]
        elif kind in TYPES:
            arrays.append(np.ascontiguousarray(own, TYPES[kind]).reshape(-1))
            document[field] = arrays[-1].size
        else:
            document[field] = int(own) if kind == "count" else float(own)
    return document
