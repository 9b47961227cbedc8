"""Tables of the records of ``benchmarks.representation`` and ``benchmarks.loss_ablation`` for the documents."""

from __future__ import annotations

from typing import Any

from benchmarks.common import cells, provenance
from drape.geometry.jets import FULL_COUNT

FORM_NAMES = {
    "skinning": "skinning",
    "skinning_push": "skinning + push-out",
    "paper": "paper: height jet, translation, scale; vertices skinned",
    "paper_turning": "+ free rotation",
    "skinned_2": "in-plane order 2, vertices skinned",
    "rigid_1": "in-plane order 1, frames skinned rigidly",
    "rigid_2": "in-plane order 2, frames skinned rigidly",
    "rigid_3": "in-plane order 3, frames skinned rigidly",
    "physics": "physics optimum of benchmarks.quality",
    "free": "every vertex free",
}
AGREEMENT_NAMES = {
    "network": "shipped network",
    "network_refit": "shipped network",
    "rigid_2": "energy alone",
    "refit": "energy alone",
    "agreeing": "energy and penalty",
    "agreeing_refit": "energy and penalty",
    "through": "the same through consensus",
}
LOSS_NAMES = {
    "skinning": "skinning",
    "skinning_push": "skinning + push-out",
    "paper": "equation 10, all terms",
    "no_collision": "without collision (L_col)",
    "no_metric": "without metric (L_inext)",
    "no_edges": "without edges (L_mesh_inext)",
    "no_boundary": "without boundary",
    "no_gravity": "without gravity",
    "house": "energy of training.run",
    "house_metric": "energy + metric",
    "house_jet_bending": "energy, bending from jets",
}
Record = dict[str, Any]


def form_table(record: Record) -> str:
    """Every form of patch, one line per garment and patch count."""
    lines = [
        "| garment | patches | numbers each | form | membrane / total [J] | edge % | area % | colliding % | gain |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in record["rows"]:
        if row["method"] in FORM_NAMES:
            cells = [row["garment"], _count(row.get("patches")), _count(row.get("numbers")), FORM_NAMES[row["method"]]]
            cells += [f"{row['membrane_j']:.3f} / {row['energy_j']:.3f}"]
            cells += [f"{row[key]:.2f}" for key in ("edge_pct", "area_pct", "colliding_vertex_pct")]
            lines.append(f"| {' | '.join([*cells, format(row['gain'], '.3f')])} |")
    return "\n".join([*lines, "", provenance(record)])


def agreement_table(record: Record) -> str:
    """How far charts disagree, and what is left of the gain, under penalties and after consensus."""
    lines = [
        "| garment | minimised | penalty [J/m2 per m2] | consensus | gap p99 [mm] | normals p99 [deg] | gain |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in record["rows"]:
        if row["method"] not in AGREEMENT_NAMES or row.get("percent") != 100:
            continue
        weight, rounds = row.get("disagreement_weight"), row.get("refits", 0)
        penalty = f"{weight:.0e}".replace("e+0", "e") if weight else "-"
        consensus = f"{rounds} x {row['numbers']} numbers" if rounds else "-"
        cells = [row["garment"], AGREEMENT_NAMES[row["method"]], penalty, consensus]
        cells += [f"{row[key]:.1f}" for key in ("chart_gap_p99_mm", "chart_normal_p99_deg")]
        lines.append(f"| {' | '.join([*cells, format(row['gain'], '.3f')])} |")
    return "\n".join(lines)


def bound_table(record: Record) -> str:
    """How little strain patches can have over the physics optimum, free and made to agree."""
    lines = [
        "| garment | patches | charts | penalty [J/m2 per m2] | gap p99 [mm] | normals p99 [deg] "
        "| edge over physics [pp] | area over physics [pp] | gain |",
        "|---" * 9 + "|",
    ]
    physics = {row["garment"]: row for row in record["rows"] if row["method"] == "physics"}
    for row in record["rows"]:
        agreed = row["method"] == "through" and row["numbers"] == FULL_COUNT
        if row["method"] != "rigid_2" and not agreed:
            continue
        best, weight = physics[row["garment"]], row.get("disagreement_weight")
        charts = "blended, fitted to the blend, blended" if agreed else "blended"
        line = [row["garment"], _count(row["patches"]), charts, f"{weight:.0e}".replace("e+0", "e") if weight else "-"]
        line += cells(row, {"chart_gap_p99_mm": ".1f", "chart_normal_p99_deg": ".0f"})
        line += [f"{row[key] - best[key]:.2f}" for key in ("edge_pct", "area_pct")]
        lines.append(f"| {' | '.join([*line, format(row['gain'], '.3f')])} |")
    return "\n".join([*lines, "", provenance(record)])


def loss_table(record: Record) -> str:
    """One line per set of losses, the published figures beside."""
    lines = [
        "| loss | edge % | area % | colliding % | OneFit: edge % | area % | colliding % | membrane [J] | bending [J] "
        "| contact [J] | gap p99 [mm] | normals p99 [deg] |",
        "|---" * 12 + "|",
    ]
    columns = {
        "edge_pct": ".2f",
        "area_pct": ".2f",
        "colliding_vertex_pct": ".3f",
        "published_edge_pct": ".1f",
        "published_area_pct": ".1f",
        "published_colliding_pct": ".3f",
        "membrane_j": ".3f",
        "bending_j": ".4f",
        "contact_j": ".4f",
        "chart_gap_p99_mm": ".1f",
        "chart_normal_p99_deg": ".0f",
    }
    for row in record["rows"]:
        lines.append(f"| {' | '.join([LOSS_NAMES[row['loss']], *cells(row, columns)])} |")
    return "\n".join([*lines, "", provenance(record)])


def _count(value: int | None) -> str:
    return "-" if value is None else str(value)
