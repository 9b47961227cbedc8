"""Physics of some frames of a clip, and the figures of drapes beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.cases import CaseScene
from benchmarks.judge import ipc_optimum
from benchmarks.judge.physics_cache import CACHE_DIR
from benchmarks.measure.judged import Judged, JudgedCloth, jitter_ratio
from benchmarks.tables import Row
from drape.cloth import metrics

OPTIMA = 6  # physics is computed of at most so many frames of a clip


def figures(judge: Judged, vertices: np.ndarray, start: np.ndarray, measured: np.ndarray) -> Row:
    """Returns a row of means over the frames ``measured`` (n,) of the drapes ``vertices`` [m] (F, V, 3): energies [J],
    strain [%], detail [mm], colliding triangles and visible skin [%]; and the jitter of all frames over that of
    ``start`` (F, V, 3). ``judge`` has the n bodies."""
    drapes = vertices[measured].astype(np.float64)
    slow = judge.few.figures(drapes[judge.spread], ("colliding_triangle_pct", "skin_pixels_pct"))
    return {
        **judge.energies(drapes),
        **judge.figures(drapes, ("edge_pct", "detail_mm")),
        "jitter_ratio": jitter_ratio(vertices, start),
        "colliding_pct": slow["colliding_triangle_pct"],
        "skin_pixels_pct": slow["skin_pixels_pct"],
    }


@dataclass(frozen=True, eq=False)
class Bound:
    """Physics of n of the measured frames of a clip, whose numbers among these are ``few`` (n,): the drapes
    ``vertices`` [m] (n, V, 3), their mean energy and detail, and the processor time of a frame. ``judge`` judges drapes
    of these frames."""

    few: np.ndarray
    judge: Judged
    vertices: np.ndarray
    energy_j: float
    detail_mm: float
    processor_s: float

    def compare(self, row: Row, plain: Row) -> Row:
        """Returns ``gain`` and ``detail_share`` of ``row``, a row of ``figures``. Both are 0 for ``plain``, the row of
        skinning, and 1 for physics."""
        share = metrics.gain(-plain["detail_mm"], -row["detail_mm"], -self.detail_mm)
        return {"gain": metrics.gain(plain["energy_j"], row["energy_j"], self.energy_j), "detail_share": share}


def bound(scene: CaseScene, starts: Mapping[str, np.ndarray], *, keeps_apart: bool = False) -> Bound:
    """Returns physics of up to ``OPTIMA`` of the measured frames of ``scene``: the optimum near the first and the last
    of ``starts``, drapes [m] (F, V, 3) by name. If ``keeps_apart`` is true it is the optimum near the last one, of
    cloth that does not pass through itself."""
    measured = scene.clip.measured
    few = np.linspace(0, len(measured) - 1, min(OPTIMA, len(measured))).astype(int)
    plain, *_, last = (start[measured[few]].astype(np.float64) for start in starts.values())
    judge = Judged(JudgedCloth.of(scene.garment, scene.body, scene.fabric), scene.clip.body_vertices[few], plain)
    if keeps_apart:
        optimum, _ = ipc_optimum.stored_apart(judge.task((last,)), CACHE_DIR)
    else:
        optimum, _ = judge.optimum((plain, last), CACHE_DIR)
    energy_j = judge.energies(optimum.vertices)["energy_j"]
    detail_mm = judge.figures(optimum.vertices, ("detail_mm",))["detail_mm"]
    return Bound(few, judge, optimum.vertices, energy_j, detail_mm, float(optimum.processor_s.mean()))
