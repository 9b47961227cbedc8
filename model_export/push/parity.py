"""The graphs of the push-out against numpy, on skinned garments in hard poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from drape.arrays.subnormals import flushed
from drape.body.assets import load_body
from drape.contact.projection import CLEARANCE_M, push_out
from drape.contact.skin import body_skin
from drape.garment.cache import Garment
from drape.geometry.skinning import skin_points
from drape.graph.feeds import garment_feed
from drape.graph.layer_feed import pack_layer, push_over, sheet
from drape.graph.push_feed import pack_push
from model_export.parity import hard_poses, session
from model_export.push.graph import Drapes, LayerTensors, PushTensors

Case = tuple[dict[str, np.ndarray], np.ndarray]  # inputs of a graph by name, and what numpy makes of them


def push_case(garment: Garment, poses: np.ndarray, clearance_m: float = CLEARANCE_M) -> Case:
    """The push-out of ``garment``, skinned in ``poses`` (F, 24, 3)."""
    drapes, skin = _skinned(garment, poses, clearance_m), body_skin(load_body())
    feed = pack_push(garment_feed(garment), garment.vertices[: garment.vertex_count], skin)
    expected = push_out(drapes.vertices, drapes.samples(), feed, np.float32(clearance_m))
    return PushTensors(**vars(drapes), feed=feed).flat(), expected


def layer_case(outer: Garment, inner: Garment, poses: np.ndarray, clearance_m: float = CLEARANCE_M) -> Case:
    """The push-out of ``outer`` over ``inner``, both skinned in ``poses`` (F, 24, 3)."""
    drapes, under = _skinned(outer, poses, clearance_m), _skinned(inner, poses, clearance_m).vertices
    rest = outer.vertices[: outer.vertex_count]
    feed = pack_layer(garment_feed(outer), rest, body_skin(load_body()), [sheet(inner)])
    expected = push_over(drapes.vertices, under, drapes.samples(), feed, np.float32(clearance_m))
    return LayerTensors(**vars(drapes), feed=feed, under=under).flat(), expected


@flushed()
def push_parity_error(folder: Path, garment: Garment) -> float:
    """Largest vertex distance [m] between numpy and the graphs in ``folder``: of the garment, and of it worn over its
    like."""
    poses = hard_poses(3)
    cases = {"push_out": push_case(garment, poses), "push_over": layer_case(garment, garment, poses)}
    worst = 0.0
    for name, (arrays, expected) in cases.items():
        got = np.asarray(session(folder / f"{name}.onnx").run(["pushed"], arrays)[0])
        worst = max(worst, float(np.linalg.norm(got - expected, axis=-1).max()))
    return worst


def _skinned(garment: Garment, poses: np.ndarray, clearance_m: float) -> Drapes:
    body, count = load_body(), garment.vertex_count
    rotations, translations = body.bones(poses)
    rest = np.broadcast_to(garment.vertices[:count], (len(poses), count, 3)).astype(np.float64)
    vertices = skin_points(rest, garment.skin_weights(body)[:count].astype(np.float64), rotations, translations)
    drapes = Drapes(
        vertices=vertices,
        rotation=rotations,
        translation=translations,
        clearance=np.full(1, clearance_m),
        skin=body_skin(body).on_bones(body),
    )
    return drapes.each(lambda array: array.astype(np.float32) if array.dtype == np.float64 else array)
