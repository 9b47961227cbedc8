"""PolyFit beside the paper's figures: its tables 3, 6, 7 and 8, and figure 9.

    python -m benchmarks.papers.polyfit --save
    python -m benchmarks.papers.polyfit --quick

Networks that are not under ``--runs`` are trained first: all of them take a quarter of an hour on one core. ``--quick``
trains those for a few steps, elsewhere.

The paper measures on garments of CLOTH3D, which are not at hand: here it is garments that training never saw,
those of DRAPE_DATA/garments or, without such a folder, variants of the six designs. Errors therefore compare
within a table, not with the paper's column. docs/studies/polyfit.md says what each table means.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from torch import nn

from benchmarks.harness import Benchmark, Option, Run
from benchmarks.papers.polyfit import measures
from benchmarks.papers.polyfit.families import FAMILIES, Patches, draw_patches
from benchmarks.papers.polyfit.garment_patches import (
    NamedGarment,
    designed_garments,
    draw_garment_patches,
    held_out_garments,
)
from benchmarks.papers.polyfit.train import suite, train_missing
from benchmarks.tables import Row, text_table
from drape.body.assets import load_body
from drape.garment.fitting import fit_error, patch_fields

POINTS = 128
PATCH_PARTITIONS = 2  # random partitions of every garment that patches without overlap are drawn from
SEED = 777_000
COMPARED = ("gaussian", "families", "finetuned", "adapted", "pointnet", "dgcnn")
ORDERS = (1, 2, 3, 4, 5, 6)
PAPER: dict[str, dict[str, dict[str, float]]] = {
    "3": {
        "gaussian": {"paper_height": 0.0248, "paper_normal_deg": 5.485},
        "families": {"paper_height": 0.0239, "paper_normal_deg": 5.423},
        "finetuned": {"paper_height": 0.0201, "paper_normal_deg": 5.317},
    },
    "6": {
        "finetuned": {"paper_height": 0.0201, "paper_normal_deg": 5.3170},
        "pca": {"paper_height": 0.0259, "paper_normal_deg": 5.4651},
    },
    "7": {
        "tshirt": {"paper_point_rmse": 8.645e-5, "paper_normal_deg": 1.834},
        "dress": {"paper_point_rmse": 5.303e-4, "paper_normal_deg": 4.273},
        "tank": {"paper_point_rmse": 1.565e-4, "paper_normal_deg": 2.666},
        "longsleeve": {"paper_point_rmse": 2.291e-4, "paper_normal_deg": 2.951},  # the paper's "Top"
        "shorts": {"paper_point_rmse": 8.005e-4, "paper_normal_deg": 6.309},
        "trousers": {"paper_point_rmse": 7.957e-4, "paper_normal_deg": 3.193},
    },
    "8": {
        "finetuned": {"paper_height": 0.0201, "paper_normal_deg": 5.274, "paper_ms": 0.0481},
        "pointnet": {"paper_height": 0.0309, "paper_normal_deg": 6.936, "paper_ms": 0.0754},
        "dgcnn": {"paper_height": 0.0290, "paper_normal_deg": 6.406, "paper_ms": 0.0625},
    },
}
FIT = {"height_rmse": ".5f", "height_rmse_p99": ".4f", "normal_deg": ".3f", "folded_patch_pct": ".2f"}
PAPER_FIT = {"paper_height": ".4f", "paper_normal_deg": ".3f"}


def networks(folder: Path, *, quick: bool) -> dict[str, nn.Module]:
    """Every network of the comparison; with ``quick``, missing ones are trained for a few steps and not kept."""
    if not quick or all((folder / f"{name}.pt").is_file() for name in suite()):
        return train_missing(folder, suite())
    print("networks are missing: they are trained for a few steps, and their figures mean nothing", flush=True)
    short = {n: replace(c, batch_size=64, variants=0, partitions=1) for n, c in suite(share=0.01).items()}
    with tempfile.TemporaryDirectory() as scratch:
        return train_missing(Path(scratch), short)


def fit_rows(models: dict[str, nn.Module], garments: Patches, synthetic: Patches) -> list[Row]:
    """Tables 3, 6 and 8, with one row more: the frame of the mean normal, which the product uses."""
    named: dict[str, nn.Module | None] = {name: models[name] for name in COMPARED} | {"pca": None}
    measured = {
        name: measures.evaluate(model, garments)
        | {"synthetic_height": measures.evaluate(model, synthetic)["height_rmse"]}
        for name, model in named.items()
    }
    rows: list[Row] = []
    for table in ("3", "6", "8"):
        for name, paper in PAPER[table].items():
            ms = {"ms": measures.milliseconds_per_patch(named[name], garments)} if table == "8" else {}
            rows.append({"table": table, "model": name, **measured[name], **ms, **paper})
    rows.append({"table": "6", "model": "adapted", **measured["adapted"]})
    return [*rows, {"table": "6", "model": "mean normal", **measures.evaluate_mean_normal(garments)}]


def order_rows(model: nn.Module, patches: Patches) -> list[Row]:
    """Figure 9: jets of order 1 to 6, in the frames of PolyFit and of the principal axes."""
    return [
        {"table": "figure 9", "model": name, "order": order, **measures.evaluate(chosen, patches, order=order)}
        for name, chosen in (("finetuned", model), ("pca", None))
        for order in ORDERS
    ]


def shipped_rows(model: nn.Module, garments: Sequence[NamedGarment]) -> list[Row]:
    """Table 7: patches without overlap as in the paper, and the product's blended charts."""
    rows = []
    for garment in garments:
        cluster = measures.cluster_fit(model, garment)
        charts = fit_error(garment.rest, patch_fields(garment.rest, unfold=True))
        paper = PAPER["7"].get(garment.name, {})
        product = {"product_rmse_m": charts["point_rmse_m"], "product_normal_deg": charts["normal_error_deg"]}
        rows.append({"table": "7", "garment": garment.name, **cluster, **product, **paper})
    return rows


def table_texts(rows: Sequence[Row], *, where: str) -> list[str]:
    """Every table under a line that says what it is."""
    fits = {"model": "s", **FIT, "synthetic_height": ".5f", **PAPER_FIT}
    metres = dict.fromkeys(("point_rmse_m", "product_rmse_m", "paper_point_rmse"), ".2e")
    degrees = dict.fromkeys(("normal_deg", "product_normal_deg", "paper_normal_deg"), ".2f")
    tables = {
        "3": ("Table 3: what PolyFit is trained on", fits),
        "6": ("Table 6: with and without the transformer, and other frames", fits),
        "8": ("Table 8: PolyFit and point cloud encoders (ms: processor time of one patch)",
              fits | {"ms": ".4f", "paper_ms": ".4f"}),
        "7": ("Table 7: our six garments", {"garment": "s", **metres, **degrees}),
        "figure 9": ("Figure 9: order of the jet", {"model": "s", "order": "d", **FIT}),
    }  # fmt: skip
    said = f"Patches of {where}; the paper's are CLOTH3D's, so its columns say the order of rows, not their size."
    return [said] + [
        f"\n{title}\n{text_table([row for row in rows if row['table'] == table], columns)}"
        for table, (title, columns) in tables.items()
    ]


@Benchmark(
    "polyfit",
    "PolyFit beside the paper.",
    {"table": "s", "model": "s", "garment": "s", **FIT, **PAPER_FIT},
    Option("--runs", Path("runs/polyfit"), "folder of the networks", kind=Path),
)
def main(run: Run) -> None:
    """Rows of every table."""
    options, body = run.options, load_body()
    models = networks(options.runs, quick=options.quick)
    held_out, where = held_out_garments(body, folder=options.runs / "garments")
    shipped = designed_garments(body, variants=0, seed=0)
    if options.quick:
        held_out, shipped = held_out[:2], shipped[:2]
    drawn = 1 if options.quick else PATCH_PARTITIONS
    patches = draw_garment_patches(held_out, partitions=drawn, point_count=POINTS, seed=SEED)
    synthetic = draw_patches(512 if options.quick else 4096, POINTS, families=FAMILIES, seed=(SEED, 0))
    print(f"{len(patches.points)} patches of {len(held_out)} garments", flush=True)
    tuned = models["finetuned"]
    run.rows = fit_rows(models, patches, synthetic) + shipped_rows(tuned, shipped) + order_rows(tuned, patches)
    run.notes = table_texts(run.rows, where=where)
    run.extra |= {"patches_of": where, "patch_count": len(patches.points)}
    run.extra |= {"steps": {name: config.steps for name, config in suite().items()}}


if __name__ == "__main__":
    main.command()
