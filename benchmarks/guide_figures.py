"""Tables that guides and references show, each of a single record."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from statistics import fmean

from benchmarks.figures import NAMES, Records, measured_on
from benchmarks.tables import Columns, Row, cells, heads, markdown_table, rows_table

LATE: Columns = {
    "beside": ("beside", "s"), "streams": ("streams", "d"), "delay_p50_ms": ("p50 [ms]", ".1f"),
    "delay_p99_ms": ("p99", ".1f"), "delay_p999_ms": ("p99.9", ".1f"), "delay_max_ms": ("longest", ".1f"),
}  # fmt: skip
CLIENT: Columns = {
    "garment": ("garment", "s"), "frame_bytes": ("a frame of vertices [B]", ","), "jets_bytes": ("of jets [B]", ","),
    "server_ratio": ("the service's time", ".2f"), "browser_ms": ("the page's, in Chromium [ms]", ".1f"),
    "ten_mm": ("apart, same network, 10 frames [mm]", ".4f"), "first_mm": ("with jets, the first second [mm]", ".1f"),
    "smooth_mm": ("jets without folds [mm]", ".0f"),
}  # fmt: skip
LOCAL: Columns = {
    "garment": ("garment", "s"), "browser_ms": ("a frame in Chromium [ms]", ".1f"),
    "least_ratio": ("its engine in Node.js over the service's frame", ".1f"),
    "ten_mm": ("apart in ten frames [mm]", ".3f"), "first_mm": ("in the first second [mm]", ".2f"),
}  # fmt: skip
CHARACTERS = {
    "cryptovoxels_vrm0": "a doll of pieces, VRM 0, facing -z, 1.49 m",
    "kenney": "a stylised child, few bones, 3.8 units tall",
    "m2m_female_ue": "a mannequin, Unreal's names",
    "m2m_female_vrm1_synth": "the same as VRM 1",
    "makehuman_default": "a person, MakeHuman's 163 bones, A-pose",
    "viverse_mannequin": "a mannequin of pieces, VRM's names",
}
WAYS = {
    "floor": "floor of the network",
    "passes 0, folds 0": "no corrections, no folds",
    "passes 0, folds 1 coarse": "no corrections, 1 step of a coarse cloth",
    "passes 1, folds 1 coarse": "1 correction, 1 step of a coarse cloth",
    "ncs": "a step of NCS, random weights",
    "torch_eager": "the network alone in eager torch",
    "passes all, folds 2": "all corrections, 2 steps of all vertices",
    "skinning_push": "skinning with SciPy push-out",
    "32 steps of 1 iteration": "Newton's VBD, 32 steps of 1 iteration",
    "32 steps of 3 iterations": "Newton's VBD, 32 steps of 3 iterations",
    "physics": "physics",
}


def lateness(records: Records) -> str:
    """Returns a Markdown table of how late frames of streams come [ms]. It has a row for each kind of work that runs
    beside the streams, and one with the medians of the runs beside none."""
    record = records["lateness"]
    rows = [row for row in record["rows"] if row["run"] == "median" or row["beside"]]
    table = rows_table(LATE, (row | {"beside": row["beside"] or "nothing"} for row in rows))
    runs = max(int(row["run"]) for row in record["rows"] if row["run"].isdigit())
    told = f"Rows beside nothing are medians of {runs} runs, the others one run."
    return f"{table}\n\n{told} {measured_on(record, 'lateness.json')}"


def client_folds(records: Records) -> str:
    """Returns a Markdown table of streams whose folds a page computes, with a row for each garment: bytes of a message,
    times, and the distance [mm] of the page's drape from the service's."""
    return _by_garment(records, "client_folds", CLIENT)


def static_page(records: Records) -> str:
    """Returns a Markdown table of drapes that a page computes without a service, with a row for each garment: times,
    and the distance [mm] of its drape from the service's."""
    return _by_garment(records, "static_page", LOCAL)


def avatars(records: Records) -> str:
    """Returns a Markdown table with a row for each stranger's character: how far the body is from its surface [mm], the
    error of poses [degrees], and the skin that garments show on it [% of pixels]."""
    lines = []
    for character, name in CHARACTERS.items():
        rows = [row for row in records["avatars"]["rows"] if row["avatar"] == character]
        fit = f"{rows[0]['fit_median_mm']:.1f}, {rows[0]['fit_p95_mm']:.1f}"
        back = f"{max(row['retarget_deg'] for row in rows):.2f}"
        shown = [_shown(row for row in rows if row["garment"] == garment) for garment in ("tshirt", "trousers")]
        lines.append([name, fit, back, *shown])
    titles = ["character", "fit, median, 95 % [mm]", "there and back [degrees]"]
    more = ["skin through, T-shirt: walk, squat [% of pixels]", "trousers: walk, squat"]
    return f"{markdown_table([*titles, *more], lines)}\n\n{measured_on(records['avatars'], 'avatars.json')}"


def proof(records: Records) -> str:
    """Returns a Markdown table with a row for each fabric: its bending lengths [mm] and drape coefficient [%] in the
    simulator, beside theory and published values."""
    record, lines = records["fabrics"], []
    for fabric in dict.fromkeys(row["fabric"] for row in record["rows"]):
        rows = [row for row in record["rows"] if row["fabric"] == fabric]  # the coarsest mesh first
        fine = rows[-1]
        bent = [
            f"{1e3 * fine[f'bending_length{side}_m']:.1f} / {1e3 * fine[f'peirce{side}_m']:.1f}"
            for side in ("", "_weft")
        ]
        low, high = fine["range_pct"]
        band = f"{low:.0f}-{high:.0f}{'' if fine['inside_range'] else ' **outside**'}"
        draped = ", ".join(f"{row['drape_coefficient_pct']:.1f}" for row in rows)
        lines.append([fabric, *bent, draped, band, ", ".join(str(row["nodes"]) for row in rows)])
    titles = ["fabric", "bending length / Peirce, warp [mm]", "weft [mm]"]
    more = ["drape coefficient [%], edges of 14, 10, 7 mm", "published band", "nodes"]
    return f"{markdown_table([*titles, *more], lines)}\n\n{measured_on(record, 'fabrics.json')}"


def yardsticks(records: Records) -> str:
    """Returns a Markdown table with a row for each of our settings and each other program: its time over that of the
    rival, and its gain, both for a T-shirt and for a dress."""
    lines, columns = [], {"time_ratio": "{:.2f}", "gain": "{:.2f}"}
    for way, name in WAYS.items():
        rows = [row for row in records["yardsticks"]["rows"] if way in (row["tier"], row["knobs"])]
        line = [name]
        for key, form in columns.items():
            means = [fmean(own) for own in (_values(rows, garment, key) for garment in ("tshirt", "dress")) if own]
            line.append(" / ".join(form.format(mean) if mean < 10 else f"{mean:.0f}" for mean in means))
        lines.append(line)
    return markdown_table(["what", "time, rival = 1: T-shirt / dress", "gain: T-shirt / dress"], lines)


BLOCKS: dict[str, Callable[[Records], str]] = {
    table.__name__: table for table in (lateness, client_folds, static_page, avatars, proof, yardsticks)
}


def _by_garment(records: Records, name: str, columns: Columns) -> str:
    rows = [row | {"garment": NAMES[row["garment"]]} for row in records[name]["rows"]]
    table = markdown_table(heads(columns), (cells(row, columns) for row in rows))
    return f"{table}\n\n{measured_on(records[name], f'{name}.json')}"


def _shown(rows: Iterable[Row]) -> str:
    """The pixels [%] that show skin in each row's clip, and in brackets those without covered faces drawn deeper."""
    rows = list(rows)
    deeper, as_it_is = (", ".join(f"{row[key]:.3f}" for row in rows) for key in ("skin_pixels_pct", "as_it_is_pct"))
    return f"{deeper} ({as_it_is})"


def _values(rows: Iterable[Row], garment: str, key: str) -> list[float]:
    return [abs(row[key]) for row in rows if row["garment"] == garment and row.get(key) is not None]
