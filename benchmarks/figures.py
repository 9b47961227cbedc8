"""Figures that README and other pages state, each computed from the records that hold it.

``BLOCKS`` has the function that writes each; ``benchmarks.report`` puts its text on the page, so that no page states a
figure that its record does not hold.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from statistics import fmean

from benchmarks.front import TRAINED
from benchmarks.tables import Columns, Record, Row, markdown_table, rows_table
from drape.stages.tiers import NAMES as TIER_NAMES

Records = Mapping[str, Record]
DEFAULT_TIER, GARMENT = "balanced", "tshirt"
SPEED = "docs/records/performance.md"  # as README links to it
NAMES = {"tshirt": "T-shirt", "dress": "dress", "trousers": "trousers"}


@dataclass(frozen=True)
class Headline:
    """The three numbers of the default tier: gain, time of a frame, and streams that a service carries.

    ``gain`` is the mean over garments and clips. ``frame_ms`` is the median processor time [ms] of a T-shirt's frame in
    a stream. A service carries ``streams`` streams on ``cores`` cores, ``fps`` poses a second each. ``pose_ms`` is the
    processor time [ms] that it then takes for one pose, and ``goodput_pct`` the share [%] of all poses sent whose
    frames came in time.
    """

    gain: float  # 0 is skinning and 1 physics; the mean over garments and clips
    frame_ms: float  # a stream's frame on one core in a program of its own, from pose to message
    streams: int  # how many a service carries on ``cores``
    cores: int
    pose_ms: float  # processor time of the service for each pose of so many streams
    fps: float  # poses a second of each stream
    goodput_pct: float  # share of the poses whose frames came in time


def headline(records: Records) -> Headline:
    """Returns the three numbers at the head of README from the records "tradeoff", "frame" and "serving"."""
    trade, serving = records["tradeoff"], records["serving"]
    (gain,) = [row["gain"] for row in trade["means"] if row["tier"] == DEFAULT_TIER]
    streams = serving["max_clients"][f"service {DEFAULT_TIER}"]
    (load,) = [row for row in _streams(serving, DEFAULT_TIER) if row["clients"] == streams]
    return Headline(
        gain=gain,
        frame_ms=_frame(records["frame"], GARMENT, DEFAULT_TIER)["bare_ms"],
        streams=streams,
        cores=_cores(serving),
        pose_ms=load["cpu_ms"],
        fps=load["fps"],
        goodput_pct=load["goodput_pct"],
    )


def three_numbers(records: Records) -> str:
    """Returns README's Markdown table of the three numbers, each with the machine of its record."""
    head, trade, serving = headline(records), records["tradeoff"], records["serving"]
    cases = {(row["garment"], row["fabric"], row["clip"]) for row in trade["rows"]}
    garments, fabrics, clips = ({case[axis] for case in cases} for axis in range(3))
    vertices = next(row["vertices"] for row in records["static_page"]["rows"] if row["garment"] == GARMENT)
    gain = (
        f"of the way from skinning (0) to physics that does not pass through itself (1): mean of {len(garments)} "
        f"garments in {', '.join(sorted(fabrics))} and {len(clips)} clips"
    )
    frame = f"of one core: a T-shirt of {vertices:,} vertices in a stream, from a pose to its message, without the wire"
    tried = max(row["clients"] for row in _streams(serving, DEFAULT_TIER))
    most = ", the most that were tried" if head.streams == tried else ""
    streams = (
        f"of {head.fps:.0f} poses a second on {head.cores} cores{most}: {head.goodput_pct:.0f} % of the frames are "
        f"back within {serving['late_ms']:.0f} ms, and a pose takes the service {head.pose_ms:.1f} ms of a core"
    )
    on = {name: processor_and_cores(records[name]) for name in ("tradeoff", "frame", "serving")}
    table = markdown_table(
        ["", "", "", "measured on", "record"],
        [
            ["gain", f"**{head.gain:.3f}**", gain, on["tradeoff"], "[trade](docs/records/tradeoff.md)"],
            ["a frame", f"**{head.frame_ms:.1f} ms**", frame, on["frame"], f"[frame]({SPEED}#frame-kernels)"],
            ["streams", f"**{head.streams}**", streams, on["serving"], f"[serving]({SPEED}#serving)"],
        ],
    )
    gpu, best = records["latency_gpu"], max(_batches(records["latency_gpu"]), key=lambda row: row["frames_per_s"])
    on_gpu = (
        f"On {gpu['machine'].split(', ')[2]} the network alone takes {best['p50_ms']:.1f} ms for {best['batch']} "
        f"frames ([record]({SPEED}#latency-gpu-batches))."
    )
    return f"{table}\n\n{on_gpu}"


def tiers(records: Records) -> str:
    """Returns a Markdown table with a row for each tier: time over that of the rival, processor time [ms], gain, detail
    share, and the skin that shows [% of pixels]."""
    record, columns = records["tradeoff"], {"time_ratio": ".2f", "cpu_ms": ".1f"}
    lines = []
    for row in record["means"]:
        if row["tier"] not in ("", "skinning_push", "physics"):
            cases = [case for case in record["rows"] if case["knobs"] == row["knobs"]]
            sets = [[case["gain"] for case in cases if (case["garment"] in TRAINED) == own] for own in (True, False)]
            gains = " / ".join(f"{fmean(gains):.3f}" if gains else "-" for gains in sets)
            cost = [format(row[key], form) for key, form in columns.items()]
            rest = [f"{row['gain_p05']:.3f}", f"{row['detail_share']:.2f}", f"{row['skin_pixels_pct']:.3f}"]
            lines.append((row["time_ratio"], [f"`{row['tier']}`", *cost, gains, *rest]))
    lines.sort()
    titles = ["tier", "time, rival = 1", "processor [ms]", "gain, trained on / unseen", "its 5th percentile"]
    table = markdown_table([*titles, "detail share", "skin [% of pixels]"], (line for _, line in lines))
    return f"{table}\n\n{measured_on(record, 'tradeoff.md#tradeoff')}"


def frame(records: Records) -> str:
    """Returns a Markdown table of the processor time [ms] of each part of a stream's frame, with the part's floor
    (``benchmarks.frame``) in brackets."""
    record = records["frame"]
    wholes = [row for row in record["rows"] if row["kind"] == "kernel" and row["stage"] == "frame"]
    cases = [(row["garment"], row["tier"]) for row in wholes]
    parts = {
        "network": lambda row: row["kernel"] == "jets",
        "posed body and its skin": lambda row: row["kernel"] == "pose_body",
        "vertices of the jets": lambda row: row["kernel"] == "vertices",
        "swing": lambda row: row["stage"] == "swing" and row["kernel"] != "Python",
        "folds": lambda row: row["stage"] == "folds" and row["kernel"] != "Python",
    }
    lines = []
    for name, belongs in parts.items():
        lines.append([name, *(_timed(_kernels(record, *case), belongs) for case in cases)])
    lines.append(["Python, NumPy and small parts", *(_rest(_kernels(record, *case), parts.values()) for case in cases)])
    lines.append(["all, stage by stage", *(f"{row['cpu_ms']:.2f} ({row['floor_ms']:.2f})" for row in wholes)])
    lines.append(["the frame in one call", *(f"**{row['bare_ms']:.1f}**" for row in wholes)])
    titles = ["", *(f"{NAMES.get(garment, garment)} `{tier}`" for garment, tier in cases)]
    return f"{markdown_table(titles, lines)}\n\n{measured_on(record, 'performance.md#frame-kernels')}"


def threads(records: Records) -> str:
    """Returns a Markdown table of the frames a second that one thread computes, those of two threads, and their ratio.
    Its rows are two streams and a clip of each garment."""
    record, lines = records["frame_views"], []
    rows = [row for row in record["rows"] if row["kind"] == "threads"]
    for garment, what in dict.fromkeys((row["garment"], row["what"]) for row in rows):
        pair = sorted((row for row in rows if (row["garment"], row["what"]) == (garment, what)), key=_threads)
        one, two = (row["frames_per_s"] for row in pair)
        lines.append([f"{NAMES.get(garment, garment)}, {what}", f"{one:.0f}", f"{two:.0f}", f"{two / one:.2f}"])
    titles = ["", "frames/s of one thread", "of two", "ratio"]
    return f"{markdown_table(titles, lines)}\n\n{measured_on(record, 'performance.md#frame-threads')}"


def one_frame(records: Records) -> str:
    """Returns a Markdown table of all times [ms] that pages state of a frame of the default tier: what is measured, by
    which clock, and in which record."""
    head, serving = headline(records), records["serving"]
    (trade,) = [row for row in records["tradeoff"]["means"] if row["tier"] == DEFAULT_TIER]
    (single,) = [row for row in _streams(serving, DEFAULT_TIER) if row["clients"] == 1]
    alone_ms, stream = serving["model_ms"][DEFAULT_TIER], "a T-shirt's stream in a program"
    lines = [
        [f"{stream}, one frame after the other", "processor", head.frame_ms, "frame"],
        ["the mean over garments and clips, which `GET /tiers` tells", "processor", trade["cpu_ms"], "tradeoff"],
        [f"{stream} with pauses, {head.fps:.0f} frames a second", "wall", alone_ms, "serving"],
        [f"a pose of {head.streams} T-shirts' streams, the service's process", "processor", head.pose_ms, "serving"],
        ["a pose of one T-shirt's stream, the service's process", "processor", single["cpu_ms"], "serving"],
    ]  # fmt: skip
    rows = ([what, clock, f"{ms:.1f}", f"`{source}.json`"] for what, clock, ms, source in lines)
    return markdown_table([f"`{DEFAULT_TIER}`: what is measured", "clock", "[ms]", "record"], rows)


def streams(records: Records) -> str:
    """Returns a Markdown table of streams under load: goodput, age of frames and processor time of each tier with one
    client, with eight and with the most that are carried, under overload, and of a still body."""
    record = records["serving"]
    lines = []
    for tier in TIER_NAMES:
        for row in _streams(record, tier):
            if row["clients"] in (1, 8, record["max_clients"][f"service {tier}"]):
                lines.append([f"`{tier}`, {row['clients']}", *_load(row)])
    for row in record["rows"]:
        if row["case"].startswith("overload"):
            lines.append([f"`{row['tier']}`, {row['clients']}: {row['case'].removeprefix('overload, ')}", *_load(row)])
        if row["case"] == "still":
            lines.append([f"`{row['tier']}`, a still body", *_load(row)])
    titles = ["tier, clients", "goodput [%]", "age p50, p99 [ms]", "processor a pose [ms]"]
    return f"{markdown_table(titles, lines)}\n\n{_carried(record)} {measured_on(record, 'performance.md#serving')}"


def gpu_batches(records: Records) -> str:
    """Returns a Markdown table of calls of the network on a GPU, for frames of all garments: the median time [ms] of a
    call and the frames a second, by the number of frames in a call."""
    record = records["latency_gpu"]
    rows = _batches(record)
    lines = [
        ["p50 [ms]", *(f"{row['p50_ms']:.1f}" for row in rows)],
        ["frames/s", *(f"{row['frames_per_s']:,.0f}" for row in rows)],
    ]
    table = markdown_table(["frames in a call", *(str(row["batch"]) for row in rows)], lines)
    return f"{table}\n\n{measured_on(record, 'performance.md#latency-gpu-batches')}"


def views(records: Records) -> str:
    """Returns a Markdown table of the time [ms] of a whole frame, and of one for which a client asks less: a garment
    far away, or a hidden one."""
    columns: Columns = {
        "garment": ("garment", "s"), "case": ("case", "s"), "what": ("what", "s"), "full_ms": ("in full [ms]", ".1f"),
        "cpu_ms": ("so [ms]", ".2f"), "saving": ("saved", ".0%"),
    }  # fmt: skip
    rows = [row for row in records["frame_views"]["rows"] if row["kind"] == "view"]
    rows = [row | {"saving": round(row["saving"], 2) + 0.0} for row in rows]  # no negative zero
    return f"{rows_table(columns, rows)}\n\n{measured_on(records['frame_views'], 'performance.md#frame-views')}"


BLOCKS: dict[str, Callable[[Records], str]] = {
    table.__name__: table
    for table in (
        three_numbers, tiers, frame, threads, one_frame, streams, gpu_batches, views,
    )
}  # fmt: skip


def processor_and_cores(record: Record) -> str:
    """Returns the processor and the number of cores that ``record`` was measured on, as words."""
    processor, cores = record["machine"].split(", ")[:2]
    return f"{processor.replace('(R)', '').replace(' Processor', '')} ({cores})"


def _threads(row: Row) -> int:
    return row["threads"]


def measured_on(record: Record, table: str) -> str:
    """Returns the sentence on where ``record`` was measured. It links to ``table`` in docs/records or, where ``table``
    is the file of a record, to that file."""
    where = "../../benchmarks/results" if table.endswith(".json") else "../records"
    return f"Measured on {processor_and_cores(record)}: [record]({where}/{table})."


def _cores(record: Record) -> int:
    return int(record["machine"].split(", ")[1].split()[0])


def _streams(record: Record, tier: str) -> list[Row]:
    """The rows of streams of ``tier`` to the service, fewest clients first."""
    rows = [row for row in record["rows"] if (row["case"], row["server"], row["tier"]) == ("streams", "service", tier)]
    return sorted(rows, key=lambda row: row["clients"])


def _load(row: Row) -> list[str]:
    age = f"{row['frame_age_p50_ms']:.0f}, {row['frame_age_p99_ms']:.0f}"
    return [f"{row['goodput_pct']:.0f}", age, f"{row['cpu_ms']:.1f}"]


def _carried(record: Record) -> str:
    own = {name.removeprefix("service "): count for name, count in record["max_clients"].items()}
    tried = sorted({row["clients"] for tier in own for row in _streams(record, tier)})
    most = ", ".join(f"{count} of `{name}`" for name, count in own.items())
    return f"Of {', '.join(map(str, tried))} clients at a time it carried {most}."


def _frame(record: Record, garment: str, tier: str) -> Row:
    (row,) = [row for row in _kernels(record, garment, tier) if row["stage"] == "frame"]
    return row


def _kernels(record: Record, garment: str, tier: str) -> list[Row]:
    rows = (row for row in record["rows"] if row["kind"] == "kernel")
    return [row for row in rows if (row["garment"], row["tier"]) == (garment, tier)]


def _timed(rows: Iterable[Row], belongs: Callable[[Row], bool]) -> str:
    """The time of those ``rows`` that belong together, and in brackets their floor."""
    part = [row for row in rows if belongs(row)]
    assert part, "a part of the frame that the record does not name"
    return f"{sum(row['cpu_ms'] for row in part):.2f} ({sum(row['floor_ms'] or 0.0 for row in part):.2f})"


def _rest(rows: Iterable[Row], parts: Iterable[Callable[[Row], bool]]) -> str:
    known = tuple(parts)
    others = (row["cpu_ms"] for row in rows if row["stage"] != "frame" and not any(part(row) for part in known))
    return f"{sum(others):.2f}"


def _batches(record: Record) -> list[Row]:
    return [row for row in record["rows"] if row["garment"] == "mixed"]
