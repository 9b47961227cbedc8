"""Proof of the fabrics: cantilever, tensile and drape tests in the simulator beside closed forms and published bands.

Every fabric on meshes of three sizes: bending length along warp and weft against Peirce's (B / w)^(1/3), stretch of
strips along warp, weft and bias against the constants, drape coefficient and nodes of Cusick's disc. Bending is tested
with a membrane that the cloth's own weight stretches by less than 0.02 %, because a stiffer one locks on
triangles; the coarsest mesh also says what the whole membrane gives.

    python -m benchmarks.fabrics [--quick] [--fabric NAME ...]
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.stats import rankdata

from benchmarks.cloth import fabric_tests
from benchmarks.harness import Benchmark, Option, Run
from drape.cloth.fabric import Fabric, plate_rigidity, tensile_modulus
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material


class Published(NamedTuple):
    """A band of drape coefficients [%] and what it holds for."""

    band_pct: tuple[float, float]
    source: str


# Bands of kinds of cloth, read second-hand; docs/reference/fabrics.md has the references.
SOFT = Published((20.0, 45.0), "silks and soft knits: 25-45; woven silk 20-40 (Matsudaira, Yang 2003)")
HEAVY_KNIT = Published((25.0, 50.0), "from soft knits (25-45) to the middle of cottons (40-60)")
PUBLISHED = {
    "jersey": SOFT,
    "rib": SOFT,
    "ponte": HEAVY_KNIT,
    "sweat": HEAVY_KNIT,
    "denim": Published((65.0, 95.0), "denims and stiff finishes: 65-95"),
    "twill": Published((50.0, 80.0), "suiting 40-70, plain cotton 60-76, stiff finishes from 65"),
    "poplin": Published((60.0, 85.0), "cotton 68.4 (Gan, Ly, Steven 1991), broad 82.9 (Matsudaira et al. 2015)"),
    "satin": SOFT,
    "chiffon": SOFT,
    "swim": HEAVY_KNIT,
}
NODES = (4, 9)  # published for a disc of 30 cm
EDGES_M = (0.014, 0.010, 0.007)  # of the disc, as garments have them
STRIP_SHARE = 0.36  # of it have the strips, which are 25 mm wide
QUICK_EDGES_M, QUICK_FABRICS = (0.016,), ("jersey", "denim")
SEEDS = 3  # of mesh and unevenness, on the coarsest mesh
OWN_WEIGHT_STRAIN = 2e-4  # that the overhang of 6 cm may show
STRIP_LOAD_N_PER_M = 19.6  # FAST's 20 gf/cm; a quarter of it on the bias, as FAST's 5 gf/cm
ANGLES = {"warp": 0.0, "bias": 0.25 * np.pi, "weft": 0.5 * np.pi}
COLUMNS = {
    "fabric": "s", "edge_mm": ".1f", "vertices": ",d", "bending_length_m": ".4f", "peirce_m": ".4f",
    "bending_error_pct": ".1f", "bias_bending_error_pct": ".1f", "stretch_error_pct": ".2f",
    "drape_coefficient_pct": ".1f", "seed_spread_pct": ".1f", "full_membrane_pct": ".1f", "nodes": "d",
}  # fmt: skip


def bending_lengths(cloth: Fabric, edge_m: float) -> dict[str, float]:
    """Bending length [m] by direction in the simulator, and Peirce's as "peirce_..."."""
    found = {}
    for name, angle in ANGLES.items():
        weight = Material.gravity_m_s2 * cloth.density_kg_m2
        closed = float(np.cbrt(plate_rigidity(cloth, np.asarray(angle)) / weight))
        found[name] = fabric_tests.bending_length(cloth, edge_m, angle_rad=angle, expected_m=closed)
        found[f"peirce_{name}"] = closed
    return found


def stretch_error_pct(cloth: Fabric, edge_m: float) -> float:
    """Largest departure [%] of a strip's extension from the closed form, along warp, bias and weft."""
    worst = 0.0
    for name, angle in ANGLES.items():
        load = STRIP_LOAD_N_PER_M * (0.25 if name == "bias" else 1.0)
        closed = fabric_tests.stretch_under(tensile_modulus(cloth, angle), load) - 1.0
        found = fabric_tests.strip_stretch(cloth, edge_m, angle_rad=angle, load_n_per_m=load) - 1.0
        worst = max(worst, abs(found / closed - 1.0))
    return 100.0 * worst


def measure(name: str, edge_m: float, *, thorough: bool) -> dict[str, Any]:
    """The row of one fabric on one mesh; ``thorough`` adds further seeds and the whole membrane."""
    cloth = fabric(name)
    overhang = fabric_tests.DISC_RADIUS_M - fabric_tests.PEDESTAL_RADIUS_M
    soft = cloth.softened(Material.gravity_m_s2 * cloth.density_kg_m2 * overhang / OWN_WEIGHT_STRAIN)
    lengths = bending_lengths(soft, STRIP_SHARE * edge_m)
    error = {side: 100.0 * (lengths[side] / lengths[f"peirce_{side}"] - 1.0) for side in ANGLES}
    drape = fabric_tests.cusick(soft, edge_m)
    low, high = PUBLISHED[name].band_pct
    row = {
        "fabric": name,
        "edge_mm": 1e3 * edge_m,
        "vertices": len(drape.vertices),
        "bending_length_m": lengths["warp"],
        "peirce_m": lengths["peirce_warp"],
        "bending_length_weft_m": lengths["weft"],
        "peirce_weft_m": lengths["peirce_weft"],
        "bending_error_pct": max(error["warp"], error["weft"], key=abs),
        "bias_bending_error_pct": error["bias"],
        "stretch_error_pct": stretch_error_pct(cloth, 2.0 * STRIP_SHARE * edge_m),
        "drape_coefficient_pct": drape.coefficient_pct,
        "range_pct": [low, high],
        "inside_range": bool(low <= drape.coefficient_pct <= high),
        "nodes": drape.nodes,
        "residual_n": drape.report.residual_n,
    }
    if thorough:
        others = [fabric_tests.cusick(soft, edge_m, seed=seed).coefficient_pct for seed in range(1, SEEDS)]
        row["seed_spread_pct"] = float(np.ptp([drape.coefficient_pct, *others]))
        row["full_membrane_pct"] = fabric_tests.cusick(cloth, edge_m).coefficient_pct
    return row


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The rows of the finest mesh summed up; ``order`` is Spearman's of drapes and middles of the bands."""
    finest = [row for row in rows if row["edge_mm"] == min(row["edge_mm"] for row in rows)]
    found = [row["drape_coefficient_pct"] for row in finest]
    bands = [float(np.mean(row["range_pct"])) for row in finest]
    order = np.corrcoef(rankdata(found), rankdata(bands))[0, 1] if len(finest) > 1 else 1.0
    return {
        "worst_bending_error_pct": max((row["bending_error_pct"] for row in finest), key=abs),
        "inside_range": sum(row["inside_range"] for row in finest),
        "fabrics": len(finest),
        "inside_nodes": sum(NODES[0] <= row["nodes"] <= NODES[1] for row in finest),
        "order": float(order),
    }


@Benchmark(
    "fabrics",
    "Textile tests of the fabrics, beside closed forms and published bands.",
    COLUMNS,
    Option("--fabric", tuple(PUBLISHED), "which", QUICK_FABRICS, choices=PUBLISHED),
)
def main(run: Run) -> None:
    """Rows of every fabric on every mesh."""
    for name in run.options.fabric:
        for edge in QUICK_EDGES_M if run.options.quick else EDGES_M:
            run.add([measure(name, edge, thorough=edge == EDGES_M[0])])
    found = summary(run.rows)
    run.notes.append(
        f"finest mesh: {found['inside_range']} of {found['fabrics']} drapes inside the published bands, order "
        f"{found['order']:.2f}, nodes inside 4 to 9 in {found['inside_nodes']}; bending length within "
        f"{abs(found['worst_bending_error_pct']):.1f} % of Peirce's"
    )
    run.extra["summary"] = found


if __name__ == "__main__":
    main.command()
