"""Pictures of who may have worn a garment: the cloth as it was delivered on each body that was found in it."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from drape.garment.files.mesh import GarmentMesh
from drape.garment.portrait import Sitter, portrait
from drape.garment.wearer_reading import WearerCandidate

SIZE_PX = 224


def pictured(wearer: WearerCandidate, mesh: GarmentMesh) -> dict[str, Any]:
    """Returns the entry of ``wearer`` for a garment's manifest (``WearerCandidate.to_json``), in which it and each of
    its ``others`` have a ``picture``: ``mesh``, which is in the frame of its file, on that body, as a PNG in base64."""
    record = wearer.to_json()
    record["picture"] = _picture(wearer, mesh)
    for entry, other in zip(record["others"], wearer.others, strict=True):
        entry["picture"] = _picture(other, mesh)
    return record


def _picture(wearer: WearerCandidate, mesh: GarmentMesh) -> str:
    skin = wearer.body.posed_vertices(wearer.pose[None], wearer.trans[None], wearer.betas)[0]
    faces = wearer.body.faces.astype(np.int64)
    cloth = wearer.reading.apply(mesh.vertices)
    sitter = Sitter(cloth, mesh.faces, mesh.uv, mesh.uv_faces, mesh.face_material, mesh.looks)
    return base64.b64encode(portrait(sitter, (skin, faces), SIZE_PX, whole=True)).decode()
