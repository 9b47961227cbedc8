"""Table 2 of Yu, Cordier and Seo (2024): what recoveries from another simulator's drapes stand beside."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.tables import Row


@dataclass(frozen=True)
class Published:
    """A row of table 2: the paper's own method. Chamfer distance read as cm^2, turning as degrees (decision 0004)."""

    chamfer_cm2: float
    normal: float
    turning_deg: float
    area_err: float


TABLE_2 = {
    "tee": Published(0.112, 0.049, 9.53, 0.09),
    "dress": Published(0.110, 0.075, 10.96, 0.10),
    "shorts": Published(0.126, 0.043, 7.37, 0.04),
    "pants": Published(0.142, 0.049, 7.12, 0.08),
    "skirt": Published(0.106, 0.014, 3.99, 0.04),
}
MEASURES = {"chamfer_cm2": ".3f", "normal": ".3f", "turning_deg": ".2f", "area_err": ".3f"}


def ahead(row: Row) -> int:
    """In how many of the four measures ``row`` is at or below the paper."""
    return sum(row[name] <= getattr(TABLE_2[row["garment"]], name) for name in MEASURES)
