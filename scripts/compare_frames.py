"""Whether two checkouts drape the same frames, bit for bit, asked through the service's public REST and stream.

python scripts/compare_frames.py dump OLD.npz     starts the service of the folder it is run in, and drapes
python scripts/compare_frames.py compare OLD.npz NEW.npz

``dump`` in the other checkout uses this file too: ``(cd OTHER && python HERE/scripts/compare_frames.py dump NEW.npz)``.
Settings are those of the environment (``DRAPE_ISA=v3`` compares processors).
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import re
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from websockets.asyncio.client import connect
from websockets.typing import Subprotocol

MAGIC, POSE, ACK, JETS = 0x45505244, 1, 2, 4
PREFIX = "<IBBHII"
SHAPE = [1.0, -1.5, 0.5, 0.0, 2.0]
OUTFIT = ["trousers", "tshirt"]
KEPT_HEADERS = ("x-drape-pushed-share", "x-drape-push-max-m", "x-drape-left-m", "x-drape-passes", "x-drape-motion")
# Of FRAME and JETS messages: the clock and the time that the frame took.
CLOCKS = {3: ((24, 32), (84, 88)), JETS: ((24, 32), (60, 64))}
STREAM_POSES = 30


@contextmanager
def service() -> Iterator[str]:
    """Runs the service of the working directory while the block runs. Yields its address, on a free loopback port."""
    root = Path.cwd()
    environment = os.environ | {"PYTHONPATH": str(root), "DRAPE_GARMENTS_DIR": str(root / "runs/no-such-folder")}
    command = [sys.executable, "-m", "service", "--host", "127.0.0.1", "--port", "0"]
    process = subprocess.Popen(command, cwd=root, env=environment, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        address = re.search(r"http://\S+", line)
        if address is None:
            raise SystemExit(f"the service did not start: {line or 'see above'}")
        yield address.group()
    finally:
        process.terminate()
        process.wait(timeout=30)


def clip(http: httpx.Client, name: str, start: int, frames: int) -> dict[str, Any]:
    """Returns ``frames`` frames of the sample clip ``name``, from the frame ``start`` on, as fields of a request to
    POST /drape: ``fps``, ``poses`` [rad] (frames, 24, 3) and ``trans`` [m] (frames, 3)."""
    motion = http.get(f"/motions/{name}").raise_for_status().json()
    rows = slice(start, start + frames)
    return {"fps": motion["fps"], "poses": motion["poses"][rows], "trans": motion["trans"][rows]}


def requests(http: httpx.Client) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yields the compared requests to POST /drape: a name, and the JSON document of the request."""
    walk, turn, squat = (clip(http, name, 20, 10) for name in ("walk", "turn", "squat"))
    for garment in [item["id"] for item in http.get("/garments").json()]:
        for name, piece in (("walk", walk), ("turn", turn), ("squat", squat)):
            yield f"{garment} {name}", {"garment": garment, **piece}
    shirt, outfit = {"garment": "tshirt"}, {"garments": OUTFIT}
    for name, worn in (("tshirt", shirt), ("outfit", outfit)):
        yield f"{name} shape", {**worn, **squat, "betas": SHAPE}
        yield f"{name} plain", {**worn, **squat, "advanced": {"push_out": False}}
        yield f"{name} passes 0", {**worn, **walk, "advanced": {"passes": 0}}
        yield f"{name} passes 2", {**worn, **walk, "advanced": {"passes": 2}}
        yield f"{name} still", {**worn, **turn, "motion": 0}
        yield f"{name} half motion", {**worn, **turn, "motion": 0.5}
        yield f"{name} jets", {**worn, **squat, "geometry": "jets"}
        yield f"{name} jets plain", {**worn, **turn, "geometry": "jets", "advanced": {"push_out": False}}
        yield f"{name} jets shape", {**worn, **walk, "geometry": "jets", "betas": SHAPE, "advanced": {"passes": 2}}
    yield "three layers", {"garments": ["shorts", "tank", "longsleeve"], **walk}


def blanked(message: bytes) -> np.ndarray:
    """Returns the bytes of a FRAME or JETS message, uint8 (N,), with its clock and the time of its computing set to
    zero, as these differ from run to run."""
    raw = np.frombuffer(message, np.uint8).copy()
    for start, stop in CLOCKS[message[5]]:
        raw[start:stop] = 0
    return raw


def jets_messages(content: bytes, patches: int) -> np.ndarray:
    """Returns the F JETS messages of ``patches`` patches that follow each other in ``content``, as ``blanked`` does:
    uint8 (F, N)."""
    size = 460 + 77 * patches
    size += -size % 4
    return np.stack([blanked(content[at : at + size]) for at in range(0, len(content), size)])


def post_drape(http: httpx.Client, request: dict[str, Any]) -> dict[str, np.ndarray]:
    """Returns the answer of POST /drape to ``request``.

    ``frames`` are world vertices [m] (F, V, 3) float32, or blanked JETS messages (F, N) uint8 where the request asks
    for jets. ``headers`` (H,) are the numbers of those ``KEPT_HEADERS`` that the answer has.
    """
    answer = http.post("/drape", json=request)
    if not answer.is_success:
        raise SystemExit(f"{answer.status_code}: {answer.text}")
    numbers = [float(answer.headers[name]) for name in KEPT_HEADERS if name in answer.headers]
    if request.get("geometry") == "jets":
        frames = jets_messages(answer.content, int(answer.headers["X-Drape-Patches"]))
    else:
        frames = np.frombuffer(answer.content, "<f4").reshape(len(request["poses"]), -1, 3)
    return {"frames": frames, "headers": np.array(numbers)}


async def stream_frames(url: str, opening: dict[str, Any], poses: np.ndarray, trans: np.ndarray) -> list[np.ndarray]:
    """Returns the blanked message (N,) uint8 of each frame of a stream that sends ``poses`` [rad] (F, 24, 3) and
    ``trans`` [m] (F, 3) one after the other.

    ``url`` is the service's address, ``opening`` the stream's first message. Half-way the stream is opened again with a
    motion knob of 0.5 and the push-out.
    """
    frames = []
    address = url.replace("http", "ws", 1) + "/stream"
    async with connect(address, subprotocols=[Subprotocol("drape.v1")], compression=None, max_size=None) as socket:
        await socket.send(json.dumps({"type": "open", **opening}))
        await socket.recv()
        for i, (pose, place) in enumerate(zip(poses, trans, strict=True)):
            if i == len(poses) // 2:
                chosen = opening.get("advanced", {}) | {"push_out": True}
                await socket.send(json.dumps({"type": "open", **opening, "motion": 0.5, "advanced": chosen}))
                await socket.recv()
            prefix = struct.pack(PREFIX, MAGIC, 1, POSE, 0, i + 1, 1)
            await socket.send(prefix + struct.pack("<d3d72f", i / 30.0, *place, *pose.ravel()))
            message = await socket.recv()
            assert isinstance(message, bytes), message
            frames.append(blanked(message))
            await socket.send(struct.pack(PREFIX, MAGIC, 1, ACK, 0, i + 1, 0))
    return frames


def dump(path: Path) -> None:
    arrays: dict[str, np.ndarray] = {}
    with service() as url, httpx.Client(base_url=url, timeout=300.0) as http:
        for name, request in requests(http):
            arrays |= {f"{name}: {part}": array for part, array in post_drape(http, request).items()}
        walk = clip(http, "walk", 40, STREAM_POSES)
        poses, trans = np.array(walk["poses"]), np.array(walk["trans"])
        body = http.get("/bodies").json()[0]["id"]
        posed = http.post(f"/bodies/{body}/posed", json=walk | {"betas": SHAPE}).raise_for_status()
        arrays["body: frames"] = np.frombuffer(posed.content, "<f4").reshape(len(poses), -1, 3)
        openings = {
            "tshirt": {"garment": "tshirt"},
            "outfit": {"garments": OUTFIT, "betas": SHAPE},
            "jets": {"garment": "tshirt", "geometry": "jets"},
            "plain": {"garment": "dress", "advanced": {"push_out": False, "passes": 1}},
        }
        for name, opening in openings.items():
            arrays[f"stream {name}: frames"] = np.stack(asyncio.run(stream_frames(url, opening, poses, trans)))
    np.savez(path, **arrays)  # pyright: ignore[reportArgumentType]
    print(f"{path}: {sum(len(array) for name, array in arrays.items() if name.endswith('frames'))} frames")


def compare(old: Path, new: Path) -> int:
    """Prints how each array of the files ``old`` and ``new`` of ``dump`` differs. Returns 1 if any array differs, else
    0."""
    with np.load(old) as first, np.load(new) as second:
        names = sorted({*first.files, *second.files})
        differs = 0
        for name in names:
            if name not in first or name not in second:
                verdict = "only in one"
            elif first[name].tobytes() == second[name].tobytes():
                verdict = ""
            elif first[name].shape != second[name].shape:
                verdict = f"shapes {first[name].shape} and {second[name].shape}"
            else:
                apart = np.abs(first[name].astype(np.float64) - second[name].astype(np.float64))
                verdict = f"differ in {np.count_nonzero(apart)} of {apart.size}, at most {apart.max():g}"
            differs += bool(verdict)
            print(f"{name:<32} {verdict or 'equal'}")
    print(f"{len(names) - differs} of {len(names)} arrays equal bit for bit")
    return int(differs > 0)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True, dest="command")
    commands.add_parser("dump").add_argument("out", type=Path)
    both = commands.add_parser("compare")
    both.add_argument("old", type=Path)
    both.add_argument("new", type=Path)
    options = parser.parse_args(arguments)
    if options.command == "compare":
        return compare(options.old, options.new)
    dump(options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
