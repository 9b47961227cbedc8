"""The text of a recovery's report: the answer first, then warnings before cutting, then the evidence."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from drape.cloth.material import MEASURED
from drape.geometry import meshes
from recovery.fit.objective import ease_left
from recovery.fit.outcome import Recovered
from recovery.pattern import geometry
from recovery.run import report_pictures
from recovery.run.identify import CAP_M, corner_names, weak_words
from recovery.run.job import Outcome
from recovery.run.report_pieces import ReportPage, add_pieces
from recovery.run.sew_anew import ANEW_MM, anew_words, describe_worn

SEAM_PCT = 0.5  # of length: edges that differ by more, beside their ease, cannot be sewn as they are drawn
GOOD_RMS_MM, FAIR_RMS_MM = 2.0, 8.0
UNSURE_M = 0.01
CUT_PCT = 15.0  # edges with their middle in the body; a T-shirt has 6 to 12 % at edges of 5 cm, and none of it shows
FAR_SHARE = 5.0  # the largest distance over the root mean square that is worth a sentence


def page_of(outcome: Outcome) -> str:
    """Returns the report as the text of one HTML page."""
    page = ReportPage(f"Sewing pattern of {outcome.task.name}")
    page.say(*report_summary(outcome))
    good, look = verdicts(outcome)
    page.table(HEADS, [key_figures(outcome)])
    page.notes(good, good=True)
    page.section("Before you cut")
    page.say("Look at these points first." if look else "Nothing stands out.")
    page.notes(look)
    add_pieces(page, outcome.written.finished)
    _shape(page, outcome)
    _pattern(page, outcome)
    _limits(page, outcome)
    _elsewhere(page, outcome)
    _making(page, outcome)
    return page.text()


HEADS = ("cut", "from the target, mean", "Chamfer", "seams differ by", "sewn anew", "from the target, sewn", "minutes")


def key_figures(outcome: Outcome) -> tuple[str, ...]:
    """Returns the figures of the page's first table as texts: cut, distances, seams and minutes, one for each of
    ``HEADS``."""
    top = top_of(outcome)
    return (
        top["cut"].split(". ")[0],  # the sentences stand below, before cutting
        f"{top['distance_mean_mm']:.1f} mm",
        f"{top['chamfer_cm2']:.2f} cm²",
        f"{top['seam_max_pct']:.2f} %",
        *("refused" if far is None else f"{far:.1f} mm" for far in (top["sewn_anew_mm"], top["sewn_from_target_mm"])),
        f"{top['minutes']:.1f}",
    )


def top_of(outcome: Outcome) -> dict[str, Any]:
    """Returns the figures that a recovery is judged by, for JSON: "distance_mean_mm", "chamfer_cm2", "seam_max_pct",
    "sewn_anew_mm", "sewn_from_target_mm", the words "cut", "minutes". Those with "sewn" are None if sewing failed."""
    return {
        "distance_mean_mm": outcome.near.distance.mean_mm,
        "chamfer_cm2": outcome.near.chamfer.squared_cm2,
        "seam_max_pct": round(seam_max_pct(outcome), 6),
        "sewn_anew_mm": None if outcome.sewn.anew is None else outcome.sewn.anew.distance.mean_mm,
        "sewn_from_target_mm": None if outcome.sewn.distance is None else outcome.sewn.distance.mean_mm,
        "cut": cut_of(outcome),
        "minutes": round(outcome.seconds / 60.0, 2),
    }


def report_summary(outcome: Outcome) -> list[str]:
    """Returns three sentences: what was found, how near it lies to the target, and how the base was changed."""
    pattern, distance, graded = outcome.pattern, outcome.near.distance, outcome.recovered.graded
    return [
        f"A pattern of {len(pattern.panels)} panels and {len(pattern.stitches)} seams was found from the base "
        f"{outcome.task.cut.called}.{style_words(outcome)}",
        f"Draped on the same body, the garment lies {distance.mean_mm:.1f} mm from the target on average; the base lay "
        f"{outcome.near.before.mean_mm:.0f} mm away.",
        f"On the way panels became {_percent(graded.widths)} in width and {_percent(graded.heights)} in height, before "
        "single corners were moved.",
    ]


def style_words(outcome: Outcome) -> str:
    """Returns a sentence, after a space, on the lines that were drawn into the pattern; empty without a style."""
    if not outcome.written.style:
        return ""
    finished = outcome.written.finished
    return (
        f" With {outcome.written.style.words()} it has {len(finished.panels)} pieces and {len(finished.stitches)} "
        "seams: lines that are sewn again move no cloth."
    )


def _percent(factors: np.ndarray) -> str:
    low, high = (100.0 * (factor - 1.0) for factor in (factors.min(), factors.max()))
    return f"{low:+.0f} %" if high - low < 1.0 else f"{low:+.0f} to {high:+.0f} %"


def verdicts(outcome: Outcome) -> tuple[list[str], list[str]]:
    """Returns sentences on what is well, and sentences on what to look at."""
    good, look = [], list(outcome.task.warnings)
    rms, largest = outcome.near.distance.rms_mm, outcome.near.distance.largest_mm
    line = f"Target and result are {rms:.1f} mm apart (root mean square)."
    if rms <= GOOD_RMS_MM:
        good.append(line)
    elif rms <= FAIR_RMS_MM:
        look.append(f"{line} Lengths and widths can be trusted; single folds are not the target's.")
    else:
        look.append(
            f"{line} That is far: let corners go farther from the base (--reach 0.3), or take another base, fabric or "
            "body."
        )
    if largest > FAR_SHARE * rms:
        look.append(f"At one place they are {largest:.0f} mm apart: see the red spots in the picture.")
    worst = seam_max_pct(outcome)
    if worst > SEAM_PCT:
        look.append(f"Edges that are sewn together differ by up to {worst:.1f} % beside their ease: even them out.")
    else:
        good.append(
            f"All seams can be sewn: edges have the lengths that they should have within {max(worst, 0.01):.2g} %."
        )
    mismatches = [100.0 * abs(seam.mismatch) for seam in geometry.seams(outcome.written.finished)]
    if eased := [percent for percent in mismatches if percent > SEAM_PCT]:
        look.append(
            f"{len(eased)} seams have ease, up to {max(eased):.1f} %: the table of seams says which edge to hold in."
        )
    slack_m = outcome.near.identifiability.slack_m
    if unsure := int((slack_m > UNSURE_M).sum()):
        look.append(
            f"{unsure} of {len(slack_m)} corners could move by more than a centimetre without a "
            "difference that the target shows: see what the target cannot tell."
        )
    if not outcome.recovered.fitted.finished:
        look.append("The search ended because no further step helped or came to rest, not because it had converged.")
    if outcome.recovered.left:
        look.append(f"A part of the search was left out: {outcome.recovered.left}.")
    if outcome.sewn.anew is not None:
        draped = outcome.sewn.anew.draped
        if draped.at_rest:
            good.append("Sewn anew from flat panels, the garment comes to rest on the body.")
        else:
            left = max(drape.report.residual_n for drape in (draped.rest, draped.posed) if drape is not None)
            look.append(f"Sewn anew, the garment is not at rest: {left:.1e} N are left at a node.")
        look += cut_words(draped.figures["rest"]["edges_in_body_pct"], draped.figures["edge_length_m"])
        (good if outcome.sewn.anew.distance.mean_mm <= ANEW_MM else look).append(anew_words(outcome.sewn.anew))
    return good, look


def seam_max_pct(outcome: Outcome) -> float:
    """Returns the largest error [%] of a seam: how far the ratio of its edges' lengths is from the one in the base."""
    return 100.0 * float(np.abs(ease_left(outcome.pattern, outcome.task.base)).max(initial=0.0))


def cut_of(outcome: Outcome) -> str:
    """Returns the cut in words: its base, its panels and seams, and in what it differs from the target's."""
    pattern = outcome.pattern
    words = f"{outcome.task.cut.called}: {len(pattern.panels)} panels, {len(pattern.stitches)} seams"
    if outcome.written.style:
        finished = outcome.written.finished
        words += (
            f"; with {outcome.written.style.words()}: {len(finished.panels)} pieces, {len(finished.stitches)} seams"
        )
    return ". ".join((words, *outcome.task.cut.differs))


def cut_words(edges_in_body_pct: float, edge_length_m: float) -> list[str]:
    """Returns a list with a sentence if more than ``CUT_PCT`` of the drape's edges go through the body, otherwise an
    empty one.

    Edges of the length ``edge_length_m`` [m] may do so though their ends are clear.
    """
    if edges_in_body_pct <= CUT_PCT:
        return []
    return [
        f"{edges_in_body_pct:.0f} % of the edges of the sewn garment cut the body, which shows through in pictures: "
        f"edges of {100 * edge_length_m:.0f} cm are too long for cloth this tight. Find the pattern with shorter ones "
        f"(--edge-length {0.6 * edge_length_m:.2g}), or look at the sleeves."
    ]


def _shape(page: ReportPage, outcome: Outcome) -> None:
    page.section("Target and result")
    skin = outcome.task.wearer.skin
    page.picture(
        report_pictures.target_and_result(
            report_pictures.MeshArrays(outcome.task.mesh.vertices, outcome.task.mesh.faces),
            report_pictures.MeshArrays(outcome.nodes, outcome.recovered.search.mesh.faces),
            report_pictures.MeshArrays(skin.vertices - outcome.task.wearer.trans, skin.faces),
        ),
        "Above the target, in the middle the recovered garment, below its distance from the target. Under the cloth "
        "the body is drawn a centimetre thinner than it is.",
    )
    d, far, floor = outcome.near.distance, outcome.near.chamfer, outcome.near.floor
    page.say(
        "Distances run from points of either surface to the other surface. The Chamfer distance compares drawn points "
        "instead, so it never reaches zero: its floor is what the target has against itself, drawn anew."
    )
    page.table(
        ("measure", "value"),
        [
            ("mean distance", f"{d.mean_mm:.2f} mm"),
            ("root mean square", f"{d.rms_mm:.2f} mm"),
            ("95 % of the points within", f"{d.p95_mm:.2f} mm"),
            ("largest distance", f"{d.largest_mm:.1f} mm"),
            ("Chamfer distance, squared", f"{far.squared_cm2:.4f} cm² (floor {floor.squared_cm2:.4f})"),
            ("Chamfer distance, mean", f"{far.mean_mm:.2f} mm (floor {floor.mean_mm:.2f})"),
        ],
    )
    page.picture(
        report_pictures.search_history(outcome.recovered.fitted.history), "How the search came nearer to the target."
    )


def _pattern(page: ReportPage, outcome: Outcome) -> None:
    page.section("Against the base")
    page.picture(
        report_pictures.panels_over_base(outcome.task.base, outcome.pattern),
        "Recovered panels, filled, over the base's, dashed; all at one scale.",
    )
    rows = []
    for old, new in zip(outcome.task.base.panels, outcome.pattern.panels, strict=True):
        size = np.ptp(geometry.outline(new), axis=0)
        change = geometry.area(new) / geometry.area(old) - 1.0
        rows.append((new.name, f"{100 * size[0]:.1f}", f"{100 * size[1]:.1f}", f"{100 * change:+.1f} %"))
    page.table(("panel", "width [cm]", "height [cm]", "area against the base"), rows)


def _limits(page: ReportPage, outcome: Outcome) -> None:
    limits = outcome.near.identifiability
    page.section("What the target cannot tell")
    sure = int((limits.slack_m <= UNSURE_M).sum())
    page.say(
        f"A scan shows where the cloth is, not where along it a seam runs. If what the target shows may change by "
        f"{1e3 * limits.tolerance_m:.1f} mm (root mean square), {sure} of {len(limits.slack_m)} corners are known to a "
        "centimetre. These can go farthest:"
    )
    names = corner_names(outcome.pattern)
    worst = np.argsort(-limits.slack_m, kind="stable")[:8]
    far = [
        (
            names[k],
            f"more than {100 * CAP_M:.0f} cm" if limits.slack_m[k] >= CAP_M else f"{1e3 * limits.slack_m[k]:.0f} mm",
        )
        for k in worst
    ]
    page.table(("corner", "may move by"), far)
    page.picture(
        report_pictures.undetermined_corners(limits, outcome.pattern),
        "Discs: how far [mm] each corner may move unseen. Right: how far the cloth moves, and how much of it the "
        "target shows, for every change of shape, strongest first. Openings and folds count more than flat cloth, so "
        "that the target can show more than the cloth moves on average.",
    )
    page.say("The changes of shape that the target shows least:")
    page.notes(weak_words(limits, outcome.pattern))
    page.say(
        f"Of {len(limits.seen)} independent changes of shape that the symmetries leave, the target shows the best one "
        f"at {limits.seen[-1]:.2g} and the poorest at {limits.seen[0]:.2g} mm per mm (condition "
        f"{limits.seen[-1] / max(float(limits.seen[0]), 1e-12):.0f}); the cloth itself moves by "
        f"{limits.cloth[0]:.2g} to {limits.cloth[-1]:.2g}. "
        "These are derivatives: they hold for small changes."
    )


def _elsewhere(page: ReportPage, outcome: Outcome) -> None:
    if not outcome.sewn.worn:
        return
    page.section("On other bodies and in other poses")
    page.say("The same pattern, sewn and draped again by the simulator; nothing was fitted here.")
    page.picture(report_pictures.worn_elsewhere(outcome.sewn.worn), "Above from the front, below from behind.")
    page.table(("where", "how"), [(w.what, w.refusal or describe_worn(w)) for w in outcome.sewn.worn])


def _making(page: ReportPage, outcome: Outcome) -> None:
    page.section("How it was made")
    page.say(
        f"The target has {len(outcome.task.mesh.vertices):,} vertices and was draped on {outcome.task.wearer.source}."
    )
    page.say(cloth_words(outcome.recovered))
    search = outcome.recovered.search
    page.say(
        f"The simulator's mesh has {search.mesh.node_count:,} nodes; {search.free.count} numbers were free; the "
        f"search took {len(outcome.recovered.fitted.history) - 1} steps, everything {outcome.seconds:.0f} s."
    )
    page.table(("file", "what it is"), [(path.name, file_words(path.name)) for path in outcome.files])


def cloth_words(recovered: Recovered) -> str:
    """Returns sentences on the cloth that was assumed, with its constants."""
    cloth = recovered.fitted.cloth
    figures = (
        f"{1e3 * cloth.density_kg_m2:.0f} g/m², stretch stiffness {cloth.h00:.0f} N/m across and {cloth.h11:.0f} "
        f"along, bending stiffness {1e6 * cloth.bending_j:.0f} µJ"
    )
    kind = "a measured fabric" if recovered.fabric in MEASURED else "a cloth of the simulator's, not a measured one"
    return f"The cloth was taken to be {recovered.fabric}, {kind}: {figures}. It was given, not recovered."


def file_words(name: str) -> str:
    """Returns a phrase on the purpose of a written file called ``name``; empty for another kind of file."""
    if name.endswith("_rest.obj"):
        return "the garment sewn anew, in the T-pose"
    kinds = {
        "json": "the pattern with its seams; recovery.drape and recovery.pattern read it",
        "svg": "the pieces at true size, for a browser or a plotter",
        "dxf": "the pieces for a cutter (AAMA layers)",
        "pdf": "the pieces at true size on A4 sheets",
        "obj": "the simulated garment, panels as texture coordinates",
        "glb": "the same for viewers",
        "npz": "the garment cache: put it among the service's garments and it moves",
    }
    return kinds.get(name.rpartition(".")[2], "")


def record_of(outcome: Outcome) -> dict[str, Any]:
    """Returns the content of ``report.json``: ``top_of``, "name", "left", "warnings", "files", "seconds"; dicts on the
    "target", "base", "body", "fabric", "graded", "search", "identifiability" and "sewn_anew" (None if that failed);
    lists "seams" and "worn"; and ``SurfaceDistance`` or ``Chamfer`` by field under "distance", "base_distance",
    "chamfer", "chamfer_floor"."""
    limits, fitted, mesh = outcome.near.identifiability, outcome.recovered.fitted, outcome.recovered.search.mesh
    anew = outcome.sewn.anew
    return {
        **top_of(outcome),
        "left": outcome.recovered.left,
        "name": outcome.task.name,
        "target": {
            "file": outcome.task.job.target.name,
            "vertices": len(outcome.task.mesh.vertices),
            "area_m2": float(meshes.face_areas(outcome.task.mesh.vertices, outcome.task.mesh.faces).sum()),
        },
        "base": {
            "name": outcome.task.cut.called,
            "told": outcome.task.cut.by_openings,
            "settings": outcome.task.cut.settings,
        },
        "body": {
            "source": outcome.task.wearer.source,
            "betas": outcome.task.wearer.betas.tolist(),
            "pose": None if outcome.task.wearer.pose is None else outcome.task.wearer.pose.tolist(),
            "trans": outcome.task.wearer.trans.tolist(),
            "residual_mm": outcome.task.wearer.residual_mm,
        },
        "fabric": {"name": outcome.recovered.fabric, "constants": asdict(fitted.cloth)},
        "warnings": outcome.task.warnings,
        "distance": outcome.near.distance._asdict(),
        "base_distance": outcome.near.before._asdict(),
        "chamfer": outcome.near.chamfer._asdict(),
        "chamfer_floor": outcome.near.floor._asdict(),
        "graded": {
            "widths": outcome.recovered.graded.widths.tolist(),
            "heights": outcome.recovered.graded.heights.tolist(),
            "misfit": outcome.recovered.graded.misfit,
        },
        "search": {
            "nodes": mesh.node_count,
            "free": outcome.recovered.search.free.count,
            "steps": len(fitted.history) - 1,
            "loss_m2": float(fitted.history[:, 0].min()),
            "finished": fitted.finished,
        },
        "seams": [
            {
                "first": str(seam.stitch.first),
                "second": str(seam.stitch.second),
                "first_m": seam.first_m,
                "second_m": seam.second_m,
                "mismatch": seam.mismatch,
            }
            for seam in geometry.seams(outcome.written.finished)
        ],
        "identifiability": {
            "cloth": limits.cloth.tolist(),
            "seen": limits.seen.tolist(),
            "tolerance_m": limits.tolerance_m,
            "corners": dict(enumerate(corner_names(outcome.pattern))),
            "slack_m": limits.slack_m.tolist(),
        },
        "sewn_anew": None
        if anew is None
        else {
            **anew.draped.figures,
            "distance": anew.distance._asdict(),
            "by_itself": anew.by_itself._asdict(),
            "belt_moved_m": anew.belt_moved_m,
        },
        "worn": [
            {"what": worn.what, "refusal": worn.refusal, "lost": list(worn.lost), **worn.figures}
            for worn in outcome.sewn.worn
        ],
        "files": [path.name for path in outcome.files],
        "seconds": round(outcome.seconds, 1),
    }
