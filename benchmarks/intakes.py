"""What a garment's file costs: seconds until it is worn, and milliseconds a frame then.

    python -m benchmarks.intakes --garments $DRAPE_DATA/strangers/garments --save

A row is a file with nothing said of it: its ``faces``; processor seconds of every stage of its intake, of which
``read_s`` has the search for the wearer; the vertices that are ``drawn`` and those of the ``cloth`` of its garments;
``hang_ms`` a frame for what hangs on the cloth; and ``frame_ms`` of ``balanced`` in a walk, ``over_dress`` that of the
shipped dress by turns with it. Times are of one thread.

With ``--streams 0 8`` a row more for each number: ``sent_s`` on the clock from a file's sending to a service until its
first frame is draped, beside so many streams of a T-shirt in ``balanced``, whose goodput is ``goodput_pct``.
"""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import numpy as np

from benchmarks.cases import FPS, at_rate
from benchmarks.harness import Benchmark, Option, Run
from benchmarks.served import Stream, plan_of
from benchmarks.serving import crowd, server, stream_figures
from benchmarks.stopwatch import Clock
from benchmarks.tables import Row
from clients.client import DrapeClient
from drape.body.assets import load_body
from drape.catalog import find_garments, find_motions, open_garment
from drape.errors import DrapeError
from drape.garment.cache import Garment
from drape.garment.files.mesh import read_mesh
from drape.garment.intake import STAGES, intake_outfit
from drape.motion.readers import read_motion
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings

WARM, ROUNDS, PART = 8, 6, 8  # frames before the first that counts; turns of the two streams, and frames in each
SENT_S = 60.0  # how long streams run beside an upload
COLUMNS = {
    "garment": "s", "faces": "d", "garments": "d", **{f"{stage}_s": ".1f" for stage in STAGES}, "all_s": ".1f",
    "drawn": "d", "cloth": "d", "hang_ms": ".3f", "frame_ms": ".2f", "over_dress": ".2f", "refused": "s",
    "streams": "d", "sent_s": ".1f", "goodput_pct": ".0f",
}  # fmt: skip


@Benchmark(
    "intakes",
    "What a garment's file costs until it is worn, and in a frame then.",
    COLUMNS,
    Option("--garments", ("tshirt", "dress"), "names, files or folders", ("tshirt",)),
    Option("--rounds", ROUNDS, "of frames", 2),
    Option("--streams", (), "numbers of streams beside which each file is sent to a service", kind=int),
)
def main(run: Run) -> None:
    """Adds to ``run`` a row for every file of ``--garments``, and one more for each number of ``--streams``."""
    body = load_body()
    drapery = DrapeRuntime(Settings(threads=1))
    dress = [open_garment(find_garments(["dress"])[0], body)]
    for path in find_garments(run.options.garments):
        try:
            row, garments = take_in(path)
        except DrapeError as error:
            run.add([{"garment": path.stem, "refused": str(error)[:90]}])
            continue
        run.add([row | frame_times(drapery, garments, dress, run.options.rounds)])
        run.add([upload_beside_streams(path, streams) for streams in run.options.streams])


def take_in(path: Path) -> tuple[Row, list[Garment]]:
    """Returns a row, and the garments of the file ``path``. The row has "garment", the number of "faces", the processor
    time [s] of each stage of the intake as "STAGE_s" (``STAGES``), and their sum "all_s". A shipped garment has no
    intake and no times."""
    if path.suffix == ".npz":
        garment = open_garment(path, load_body())
        return {"garment": garment.name, "faces": len(garment.surface.faces)}, [garment]
    begun: list[tuple[str, float]] = []
    garments = intake_outfit(path, begun=lambda stage: begun.append((stage, time.process_time())))
    ends = [at for _, at in begun[1:]] + [time.process_time()]
    took = {f"{stage}_s": end - at for (stage, at), end in zip(begun, ends, strict=True)}
    faces = len(read_mesh(path).faces)
    return {"garment": path.stem, "faces": faces, **took, "all_s": sum(took.values())}, garments


def upload_beside_streams(path: Path, streams: int) -> Row:
    """Returns a row with "sent_s", the wall time [s] from the upload of the file ``path`` to a service until the first
    frame of its garment, beside ``streams`` streams; if there are any, also with their "goodput_pct" [%]."""
    walk = at_rate(read_motion(find_motions(["walk"])[0]), FPS)

    async def beside(url: str) -> Row:
        begun = asyncio.Event()
        worn = {"garments": ["tshirt"], "tier": "balanced"}
        crowded = asyncio.create_task(crowd(url, walk, streams, SENT_S if streams else 0.0, begun=begun.set, **worn))
        await begun.wait()
        sent_s = await asyncio.to_thread(time_to_wear, url, path)
        views = await crowded
        return {"sent_s": sent_s, **({"goodput_pct": stream_figures(views, None)["goodput_pct"]} if streams else {})}

    with server() as at:
        return {"garment": path.stem, "streams": streams, **asyncio.run(beside(at.url))}


def time_to_wear(url: str, path: Path) -> float:
    """Returns the wall time [s] from the upload of the file ``path`` to the service at ``url`` until the first frame of
    its garment has come."""
    begun_s = time.perf_counter()
    with DrapeClient(url) as client:
        client.drape(client.upload_garment(path), np.zeros((1, 24, 3)))
    return time.perf_counter() - begun_s


def frame_times(drapery: DrapeRuntime, garments: list[Garment], dress: list[Garment], rounds: int) -> Row:
    """Returns a row of ``garments``, worn together: "frame_ms", the median processor time [ms] of a frame;
    "over_dress", its ratio to that of ``dress``; how many "garments" they are; and "drawn", "cloth" and "hang_ms" (the
    module says what these are), with None for "hang_ms" where nothing hangs on cloth.

    Both are measured by turns, so that the machine's mood counts for neither.
    """
    poses = at_rate(read_motion(find_motions(["walk"])[0]), FPS).poses
    plans = [plan_of(drapery, worn, messages=True, tier="balanced") for worn in (garments, dress)]
    streams = [Stream(plan, drapery.body.shape_count) for plan in plans]
    for turn in range(rounds + WARM // PART):
        for stream in streams:
            for frame in range(turn * PART, (turn + 1) * PART):
                stream.pose(poses[frame % len(poses)], frame / FPS)
    own, theirs = (float(np.median(stream.clock.cpu_ms[WARM:])) for stream in streams)
    hung = [garment for garment in garments if garment.drawn is not None]
    return {
        "garments": len(garments),
        "drawn": sum(garment.surface.vertex_count for garment in garments),
        "cloth": sum(garment.vertex_count for garment in garments),
        "hang_ms": sum(map(hang_ms, hung)) if hung else None,
        "frame_ms": own,
        "over_dress": own / theirs,
    }


def hang_ms(garment: Garment) -> float:
    """Returns the median processor time [ms] in which the drawn mesh of ``garment`` is moved with its cloth, in one
    frame."""
    cloth = garment.vertices[: garment.vertex_count]
    clock = Clock()
    for _ in range(50):
        with clock:
            garment.drawn_vertices(cloth)
    return float(np.median(clock.cpu_ms))


if __name__ == "__main__":
    main.command()
