"""Finds the sewing pattern of a draped skirt: python examples/07_recover_pattern.py; no service, but torch.

The target is a drape of a pattern that we know: longer than the base of the search, and wider at the hem.
"""

import numpy as np

from drape.body.assets import load_body
from recovery.drape.pattern_drape import SewingOptions, drape_pattern
from recovery.fit.objective import TargetSurface
from recovery.fit.optimise import FitOptions
from recovery.fit.rounds import RoundsOptions, recover_pattern
from recovery.pattern.bases import base_pattern
from recovery.pattern.coordinates import control_points
from recovery.pattern.measurements import measure_body

EDGE_M = 0.05  # a coarse mesh, so that this takes seconds; 0.025 is usual

body = load_body()
options = SewingOptions(edge_length_m=EDGE_M, grid_m=0.015)
base = base_pattern("skirt", measure_body(body))
true = base_pattern("skirt", measure_body(body), ["length_m=0.60", "flare_m=0.12"])
target = drape_pattern(true, body, options)

fit = FitOptions(iterations=0, closing=3)
surface = TargetSurface.from_mesh(target.nodes, target.mesh.faces)
found = recover_pattern(surface, base, body, RoundsOptions(options, fit, meshes_m=[EDGE_M]), report=print)


def error_mm(pattern) -> float:
    """Returns the mean distance [mm] of the corners of a sewing ``pattern`` from those of ``true``, the target's."""
    return 1000 * float(np.linalg.norm(control_points(pattern).positions - corners, axis=1).mean())


corners = control_points(true).positions
print(f"corners: the base {error_mm(base):.1f} mm off, the recovered pattern {error_mm(found.fitted.pattern):.2f} mm")
