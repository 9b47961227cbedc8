"""Whether moving cloth looks like cloth, tier by tier as it is served, beside stills of its own poses.

    python -m benchmarks.moving
    python -m benchmarks.moving --captured $DRAPE_DATA/motions
    python -m benchmarks.moving --garments coat.obj --motions jump.npz --tiers balanced --sheet worst.png

Garments are streamed through a clip by all stages of the service. The last frames before two places of it are measured,
each beside the still of its own pose (``benchmarks.stills``); figures are their means. ``curvature``, the first one, is
the total Gaussian curvature over the still's: cloth folds along lines, what is crumpled has peaks and dimples.
``curvature_last`` is over the still of a place's last pose, as ``curvature`` was in records until November 2026. Shares
of the still's are also ``dihedral``, the RMS angle of hinges; ``fine`` and ``middle``, the relief of waves below 2 cm
and of 2 to 8 cm; ``hem``, the third difference along hems; and ``area``. ``exact`` is that angle over the exact
drape's, where the record has one. ``pop`` is the change of fine relief from frame to frame over that relief. Of every
fifth frame are ``crossings`` and ``crossings_worst``, pairs of triangles of a garment that cross, for ten thousand of
its triangles; ``depth_mm``, how deep it is in the skin at the most; ``crossings_free`` and ``depth_free_mm``, the same
without cloth within 3 cm of skin that crosses itself, as in a squat's lap, where no place is off the skin; ``inside``
and ``inside_worst``, vertices more than a centimetre in it, in the mean and the worst frame; and ``strain_pct``, the
99.9th percentile of edges. ``jitter`` is the third difference in time over the skin's. ``resets`` are frames begun
anew. ``ms`` is a frame's processor time. Rows are printed with the worst first; ``--sheet`` draws the worst clip of
every garment in each tier. Captured motion throws limbs about as the shipped clips do not: of ``--captured`` clips the
two seconds with most movement are worn by a few garments, and have means of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from benchmarks.cases import FPS, CaseClip, lively_clips, read_case_clips
from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.measure.cloth_looks import ClothLooks
from benchmarks.measure.contact_sheet import Picture, draw_sheet
from benchmarks.measure.depth import depths_mm
from benchmarks.measure.intersections import intersecting_pairs
from benchmarks.served import Stream, plan_of
from benchmarks.stills import CAPTURED, Stills, input_of, looks_of, outfits, posed_at, still_figures
from benchmarks.tables import Row
from drape.body.assets import load_body
from drape.cloth.metrics import third_difference_square
from drape.garment.cache import Garment
from drape.garment.fine import fine_garment
from drape.stages.tiers import NAMES as TIER_NAMES
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings

TIERS = TIER_NAMES[1:]  # the least has no folds to look at
EVERY = 5  # frames between two in which crossings and depth are counted
DEEP_MM = 10.0  # no lift hides a vertex so deep in the skin
OVERLAP_M = 0.03  # cloth so near to skin that crosses itself is left out of the free figures
SHARES = {"curvature": "curvature", "dihedral": "dihedral_deg", "fine": "fine_mm", "middle": "middle_mm",
          "hem": "hem_mm", "area": "area_m2"}  # fmt: skip
COLUMNS = {
    "garment": "s", "clip": "s", "tier": "s", **dict.fromkeys(SHARES, ".2f"), "area": ".3f",
    "curvature_last": ("of last", ".2f"), "exact": ".2f", "pop": ".2f", "crossings": ".1f",
    "crossings_worst": ("worst", ".0f"), "crossings_free": ("free", ".1f"), "depth_mm": ".1f",
    "depth_free_mm": ("free", ".1f"), "inside": ".1f", "inside_worst": ("worst", ".0f"), "strain_pct": ".0f",
    "jitter": ".2f", "resets": ".1f", "ms": ".2f",
}  # fmt: skip
NAMES = ("garment", "clip", "tier")


@dataclass(frozen=True, eq=False)
class ClipSkin:
    """The skin of the body of ``clip``, as a mesh that moves through the world."""

    clip: CaseClip
    _crossing: dict[int, KDTree | None] = field(default_factory=dict)

    @cached_property
    def vertices(self) -> np.ndarray:
        """The vertices [m] (F, V, 3) in the world, float32."""
        chunks = np.array_split(np.arange(len(self.clip.poses)), max(1, len(self.clip.poses) // 20))
        posed = (self.clip.body.posed_vertices(self.clip.poses[rows], self.clip.trans[rows]) for rows in chunks)
        return np.concatenate([chunk.astype(np.float32) for chunk in posed])

    def free(self, frame: int, points: np.ndarray) -> np.ndarray:
        """Returns which (N,) of ``points`` [m] (N, 3) in the world are more than ``OVERLAP_M`` from any place where the
        skin crosses itself in ``frame``."""
        if frame not in self._crossing:
            vertices, faces = self.vertices[frame].astype(np.float64), self.clip.body.faces
            own = np.unique(intersecting_pairs(vertices, faces))
            self._crossing[frame] = KDTree(vertices[faces[own]].mean(axis=1)) if len(own) else None
        tree = self._crossing[frame]
        return np.full(len(points), True) if tree is None else tree.query(points)[0] > OVERLAP_M

    @cached_property
    def third(self) -> float:
        """The RMS, over vertices and frames, of the third difference [m] of the skin's vertices in time."""
        return float(np.sqrt(third_difference_square(self.vertices)))


def streamed(drapery: DrapeRuntime, garments: list[Garment], clip: CaseClip, tier: str) -> tuple[np.ndarray, Row]:
    """Returns the vertices [m] (F, V, 3) in the world of ``garments``, one garment's after the other's, worn together
    in a stream of ``clip``; and two figures of the stream: how often folds began anew (``resets``), and the median
    processor time of a frame (``ms``)."""
    stream = Stream(plan_of(drapery, garments, resolution="fine", tier=tier), clip.body.shape_count)
    frames, resets = [], 0
    for number in range(len(clip.poses)):
        batch = stream.frame(input_of(clip, number))
        frames.append(batch.world()[0])
        resets += int(batch.quality.folds_resets.sum())
    return np.stack(frames), {"resets": resets, "ms": float(np.median(stream.clock.cpu_ms[1:]))}


def shares_of(
    looks: ClothLooks, vertices: np.ndarray, stills: Sequence[dict[int, Row]], exact: Mapping[int, Row | None]
) -> Row:
    """Returns figures of a garment that moves through ``vertices`` [m] (F, V, 3), each over that of a still, as means
    over the frames that have one. A mean over no frame is NaN.

    The keys of ``SHARES`` are over the still of the frame's own pose. "curvature_last" is over the still of the last
    such frame before the same place of the clip. "exact" is the dihedral angle over that of the exact drape. ``stills``
    has, for each place of the clip (``PLACES`` of ``benchmarks.stills``), rows by frame; ``exact`` has the rows of
    exact drapes by frame.
    """
    shares: list[Row] = []
    for near in stills:
        last = near[max(near)]
        for frame, still in near.items():
            now = still_figures(looks, vertices[frame])
            shares.append({name: now[key] / still[key] for name, key in SHARES.items()})
            shares[-1]["curvature_last"] = now["curvature"] / last["curvature"]
            shares[-1]["exact"] = now["dihedral_deg"] / (exact.get(frame) or {}).get("dihedral_deg", np.nan)
    known = {name: [row[name] for row in shares if np.isfinite(row[name])] for name in shares[0]}
    return {name: float(np.mean(values)) if values else np.nan for name, values in known.items()}


def moving_row(looks: ClothLooks, vertices: np.ndarray, skin: ClipSkin) -> Row:
    """Returns those figures of a garment that moves through ``vertices`` [m] (F, V, 3) in the world that need no still:
    crossings, depth in the ``skin``, strain and jitter (the module says what they are)."""
    frames = np.arange(min(2 * EVERY, len(vertices) - 1), len(vertices), EVERY)
    pairs, body = [intersecting_pairs(vertices[i], looks.faces) for i in frames], skin.clip.body
    middles = [vertices[i][looks.faces[own[:, 0]]].mean(axis=1) for i, own in zip(frames, pairs, strict=True)]
    free = [skin.free(int(i), points).sum() for i, points in zip(frames, middles, strict=True)]
    crossings, apart = (np.array(counts) * 1e4 / len(looks.faces) for counts in ([len(own) for own in pairs], free))
    depths = np.stack([depths_mm(vertices[i], skin.vertices[i].astype(float), body.faces) for i in frames])
    inside = (depths > DEEP_MM).sum(axis=1)
    depths_free = depths * np.stack([skin.free(int(i), vertices[i]) for i in frames])
    return {
        "pop": looks.pop(vertices[-30:]),
        "crossings": float(crossings.mean()),
        "crossings_worst": float(crossings.max()),
        "crossings_free": float(apart.mean()),
        "depth_mm": float(depths.max()),
        "depth_free_mm": float(depths_free.max()),
        "inside": float(inside.mean()),
        "inside_worst": float(inside.max()),
        "strain_pct": looks.strain_pct(vertices[frames]),
        "jitter": float(np.sqrt(third_difference_square(vertices))) / skin.third,
    }


def scene_rows(
    drapery: DrapeRuntime,
    garments: list[Garment],
    looks: list[ClothLooks],
    skin: ClipSkin,
    stills: Stills,
    tier: str,
    sheet: Sheet,
) -> list[Row]:
    """Returns a row for each of ``garments``, worn together in a stream of ``tier`` through the clip of ``skin``, and
    shows the rows to ``sheet``. ``looks`` are those of the garments."""
    clip = skin.clip
    at_rest = [{frame: stills.of(garments, clip, frame) for frame in near} for near in posed_at(clip)]
    vertices, of_stream = streamed(drapery, garments, clip, tier)
    parts = np.split(vertices, np.cumsum([len(own.place) for own in looks])[:-1], axis=1)
    rows = []
    for number, (garment, own_looks, part) in enumerate(zip(garments, looks, parts, strict=True)):
        beside = [{frame: own[number] for frame, own in near.items()} for near in at_rest]
        row: Row = {"garment": garment.name, "clip": clip.name, "tier": tier}
        alone = [frame for near in beside for frame in near if len(garments) == 1]
        exact = {frame: stills.exact_of(garment, clip, frame) for frame in alone}
        moved = part.astype(float)
        row |= shares_of(own_looks, moved, beside, exact)
        rows.append(row | moving_row(own_looks, moved, skin) | of_stream)
        sheet.show(rows[-1], part[max(beside[-1])], own_looks.faces)
    return rows


@dataclass
class Sheet:
    """The pictures of the worst clips so far by garment and tier, and their ``curvature`` over that of their stills."""

    pictures: dict[tuple[str, str], Picture] = field(default_factory=dict)
    worst: dict[tuple[str, str], float] = field(default_factory=dict)

    def show(self, row: Row, vertices: np.ndarray, faces: np.ndarray) -> None:
        """Takes ``vertices`` [m] (V, 3) and ``faces`` (F, 3) as the picture of the garment and tier of ``row``, if the
        curvature in ``row`` is the largest so far."""
        key = row["garment"], row["tier"]
        if row["curvature"] > self.worst.get(key, 0.0):
            self.worst[key] = row["curvature"]
            self.pictures[key] = f"{row['clip']} {row['curvature']:.1f}", vertices, faces


def summary(rows: Sequence[Row], tiers: Sequence[str], clips: str = "") -> list[Row]:
    """Returns two rows for each of ``tiers``: the means and the largest values of all ``rows`` of that tier, without
    those that are NaN. ``clips`` is what stands in their column of clips."""
    means = []
    for tier in tiers:
        own = [row for row in rows if row["tier"] == tier]
        for name, of in (("mean", np.mean), ("worst", np.max)):
            known = {key: [row[key] for row in own if np.isfinite(row[key])] for key in COLUMNS if key not in NAMES}
            figures_of = {key: float(of(values)) if values else np.nan for key, values in known.items()}
            means.append(dict(zip(NAMES, (name, clips, tier), strict=True)) | figures_of)
    return means


@Benchmark(
    "moving",
    "Whether moving cloth looks like cloth, tier by tier.",
    COLUMNS,
    *inputs(quick_garments=("tshirt",), quick_motions=("walk",)),
    Option("--tiers", TIERS, "that are served", ("balanced",)),
    Option("--frames", 120, "of a clip at most", 30),
    *CAPTURED,
    Option("--sheet", "", "a PNG of the worst frames"),
)
def main(run: Run) -> None:
    """Adds to ``run`` a row for every garment, clip and tier, the worst first, and the means."""
    options, body = run.options, load_body()
    drapery, sheet = DrapeRuntime(Settings(threads=1, model=options.model)), Sheet()
    captured = lively_clips(options.captured, options.captured_frames, body)
    _add_rows(run, drapery, options.garments, read_case_clips(options, body, FPS), sheet)
    run.summary += summary(run.rows, options.tiers)
    run.extra |= {"frames": options.frames, "model": options.model, "means": run.summary[:]}
    if captured:
        shipped = len(run.rows)
        _add_rows(run, drapery, options.captured_garments, captured, sheet)
        run.summary += summary(run.rows[shipped:], options.tiers, "captured")
        run.extra |= {"captured": run.summary[len(run.extra["means"]) :]}
    run.rows.sort(key=lambda row: -row["curvature"])
    if options.sheet:
        draw_sheet(sheet.pictures, Path(options.sheet))


def _add_rows(run: Run, drapery: DrapeRuntime, names: Sequence[str], clips: Sequence[CaseClip], sheet: Sheet) -> None:
    """Adds the rows of garments of ``names`` over ``clips``."""
    stills, skins = Stills(drapery), [ClipSkin(clip) for clip in clips]
    for garments in outfits(list(names)):
        looks = [looks_of(fine_garment(garment)) for garment in garments]  # made once: their filters take a while
        for skin in skins:
            for tier in run.options.tiers:
                run.add(scene_rows(drapery, garments, looks, skin, stills, tier, sheet))


if __name__ == "__main__":
    main.command()
