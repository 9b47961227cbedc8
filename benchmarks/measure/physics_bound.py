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
    """Returns a row of the drapes ``vertices`` [m] (F, V, 3) of a clip. ``judge`` has the bodies of the frames
    ``measured`` (n,).

    Means over these frames are the energies [J] of ``Judged.energies``, the strain "edge_pct" [%] and "detail_mm" [mm]
    (``LowPass.detail_mm``). Means over the few of ``Judged.few`` are "colliding_pct", the share [%] of vertices in the
    body, and "skin_pixels_pct". "jitter_ratio" is of all frames, over that of ``start`` (F, V, 3).
    """
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
    """The physics optimum in n frames of a clip, which stand at the indices ``few`` (n,) in ``CaseClip.measured``.

    ``vertices`` [m] (n, V, 3) are its drapes, ``energy_j`` [J] and ``detail_mm`` [mm] (``LowPass.detail_mm``) their
    means. ``processor_s`` is the mean processor time [s] in which one was computed. ``judge`` judges other drapes of
    these frames.
    """

    few: np.ndarray
    judge: Judged
    vertices: np.ndarray
    energy_j: float
    detail_mm: float
    processor_s: float

    def compare(self, row: Row, plain: Row) -> Row:
        """Returns ``gain`` and ``detail_share`` of ``row``, a row of ``figures``. Both are 0 for ``plain``, the row of
        skinning, and 1 for physics; NaN where physics has no less energy, or no more detail, than skinning."""
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
