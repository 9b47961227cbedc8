"""Tables that pages show of how near a drape is to physics and how it looks, each of a single record."""

from __future__ import annotations

from collections.abc import Callable
from statistics import fmean

from benchmarks.figures import NAMES, Records, measured_on
from benchmarks.tables import Columns, markdown_table, rows_table

SETS = {"trained": "garments that were trained on", "unseen": "others"}


def quality(records: Records) -> str:
    """Returns a Markdown table with a row for garments that were trained on and one for others: gain, and strain over
    that of physics, of the network alone and with folds."""
    record = records["quality"]
    counts = {kind: len({row["garment"] for row in record["rows"] if row["set"] == kind}) for kind in SETS}
    lines = []
    for kind, name in SETS.items():
        rows = {row["method"]: row for row in record["summary"] if row["set"] == kind}
        gains = [f"{rows[method]['gain']:.2f}" for method in ("network", "network_push", "folds")]
        strain = [f"{rows[method]['edge_over_physics_pp']:.1f}" for method in ("network", "folds")]
        lines.append([f"{counts[kind]} {name}", *gains, *strain])
    titles = ["", "gain of the network alone", "pushed out", "with two steps of folds"]
    more = ["strain over physics, network [points]", "with folds"]
    return f"{markdown_table([*titles, *more], lines)}\n\n{measured_on(record, 'quality.md#quality')}"


def two_steps(records: Records) -> str:
    """Returns a Markdown table of the gain and the time [ms] of two steps of folds on all vertices, with a row for each
    garment."""
    record, lines = records["folds"], []
    rows = [row for row in record["rows"] if row["sweeps"] == 2 and row["method"] != "skinning"]
    for garment, feels in dict.fromkeys((row["garment"], row["cloth_contact"]) for row in rows):
        cases = [row for row in rows if (row["garment"], row["cloth_contact"]) == (garment, feels)]
        spans = [(min(row[key] for row in cases), max(row[key] for row in cases)) for key in ("gain", "ms")]
        gain, took = spans
        name = f"{NAMES.get(garment, garment)}, {'cloth feels cloth' if feels else 'cloth passes through itself'}"
        lines.append([name, f"{gain[0]:.2f} to {gain[1]:.2f}", f"{took[0]:.1f} to {took[1]:.1f}"])
    return f"{markdown_table(['two steps', 'gain', 'frame [ms]'], lines)}\n\n{measured_on(record, 'folds.json')}"


def moving(records: Records) -> str:
    """Returns a Markdown table of how streams look beside the stills of their poses, with a row for each tier:
    curvature, dihedral angle, crossings and strain."""
    record = records["moving"]
    columns = ("curvature", "dihedral", "crossings_worst", "strain_pct")
    by_tier: dict[str, list[str]] = {}
    for row in record["means"]:
        numbers = [f"{row[name]:.2f}" if row[name] < 10 else f"{row[name]:.0f}" for name in columns]
        by_tier.setdefault(row["tier"], []).extend(numbers)
    heads = [
        "tier",
        *(
            f"{name}, {which}"
            for which in ("mean", "worst")
            for name in ("curvature", "dihedral", "crossings", "strain [%]")
        ),
    ]
    table = markdown_table(heads, [[tier, *numbers] for tier, numbers in by_tier.items()])
    return f"{table}\n\n{len(record['rows'])} streams. {measured_on(record, 'folds.md#moving')}"


def coarse_skin(records: Records) -> str:
    """Returns a Markdown table of the skin that shows [% of pixels] on coarse meshes of other makers, with a row for
    each way to fold them."""
    record, lines = records["skin_pixels"], []
    coarse = {row["garment"] for row in record["rows"] if row["method"] == "wrapped"}
    ways = {
        "network": "without folds",
        "folds": "folds on the delivered triangles",
        "wrapped": "folds on finer ones, the delivered mesh wrapped around them",
        "fine": "folds on finer ones, which are sent",
    }
    for method, name in ways.items():
        rows = [row for row in record["rows"] if row["method"] == method and row["garment"] in coarse]
        lines.append(
            [name, f"{fmean(row['skin_pixels_pct'] for row in rows):.4f}", f"{max(r['worst_pct'] for r in rows):.2f}"]
        )
    titles = [f"{len(coarse)} coarse meshes", "skin that shows, mean [% of pixels]", "in the worst view"]
    return f"{markdown_table(titles, lines)}\n\n{measured_on(record, 'skin_pixels.json')}"


def hem_rise(records: Records) -> str:
    """Returns a Markdown table of how far hems rise in motion [mm] without swing, with it, and in the simulator."""
    record = records["swing"]
    columns: Columns = {
        "garment": ("garment", "s"), "clip": ("clip", "s"), "method": ("method", "s"),
        "rise_mm": ("hem rises [mm]", ".0f"), "share": ("of the simulator's", ".2f"), "ms": ("frame [ms]", ".1f"),
    }  # fmt: skip
    rows = [row for row in record["rows"] if row["method"] in ("static", "swing", "simulator")]
    return f"{rows_table(columns, rows)}\n\n{measured_on(record, 'swing.md#swing')}"


BLOCKS: dict[str, Callable[[Records], str]] = {
    table.__name__: table for table in (quality, two_steps, moving, coarse_skin, hem_rise)
}
