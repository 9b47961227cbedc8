"""Clips as files for programs of animation: PC2 point caches and USD text."""

from __future__ import annotations

import itertools

import numpy as np
from fastapi.responses import StreamingResponse

from drape.export.glb import GARMENT_COLOURS
from drape.export.pc2 import pc2_head
from drape.export.usda import MovingGarment, usda_pieces
from service.compute.garments import Scene
from service.compute.sliced_thread import SlicedThread
from service.http.answers import number_bytes
from service.http.negotiation import PC2
from service.stages.placing import Placed


def export_answer(
    kind: str, scene: Scene, placed: Placed, fps: float, sliced_thread: SlicedThread, headers: dict[str, str]
) -> StreamingResponse:
    """``placed`` as a file of ``kind``, PC2 or USDA; what has roots counts from the first, where USD has an Xform."""
    vertices, point = placed.from_first()
    headers = placed.headers | headers
    if kind == PC2:
        pieces = itertools.chain([pc2_head(vertices.shape[1], len(vertices))], number_bytes(vertices))
    else:
        ends = np.cumsum([entry.vertex_count for entry in scene.layers])[:-1]
        layers = [
            MovingGarment(entry.garment, own, GARMENT_COLOURS[i % len(GARMENT_COLOURS)][:3])
            for i, (entry, own) in enumerate(zip(scene.layers, np.split(vertices, ends, axis=1), strict=True))
        ]
        pieces = usda_pieces(layers, fps, point=point)
    return StreamingResponse(sliced_thread.each(pieces), media_type=kind, headers=headers)
