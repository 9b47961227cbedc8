"""``python -m drape.exact`` compiles the kernels of tier exact and stores them, so that no job waits for it."""

from __future__ import annotations

import numpy as np

from drape.body.assets import load_body
from drape.cloth.fabric_table import fabric
from drape.exact import apart
from drape.exact.frame import Sheet
from drape.garment.cache import GARMENTS_DIR, load_garment


def compile_all() -> None:
    """Takes two steps of a shipped garment in the T-pose."""
    garment, body = load_garment(next(GARMENTS_DIR.glob("tank-*.npz"))), load_body()
    betas = np.zeros(body.shape_count)
    sheet = Sheet.of(garment, fabric(garment.fabric), body, betas, garment.vertices - body.rest_joints(betas)[0])
    one = apart.Descent(sheet.cloth, sheet.contact, sheet.body.posed(np.zeros((24, 3))), sheet.rest)
    one.go(np.zeros_like(sheet.rest))
    one.run(2, 0.0)


if __name__ == "__main__":
    compile_all()
