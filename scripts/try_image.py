"""``python scripts/try_image.py IMAGE`` runs an image as a careful cluster does, and asks for what it promises.

Its files are read-only but for one volume, its user is one that nobody has heard of, and it has no capabilities. It
must be small, ready soon, drape with the engine of an older processor too, keep what a user sends, pass its own health
check, and end in good order and in time. A failure ends this with the assertion that did not hold.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from asking import answer, drape

SIZE_LIMIT, END_LIMIT_S = 700e6, 15.0  # it drains for ten seconds; docs/guide/operate.md
READY_TARGET_S = 3.0  # told, not held: others may keep this machine busy
PORT, NAME, VOLUME = 8449, "drape-on-trial", "drape-on-trial"
OLDER = "v2" if platform.machine() in ("x86_64", "AMD64") else ""  # DRAPE_ISA
STRANGER = "4711:4711"
CAREFUL = ("--read-only", "--cap-drop=ALL", "--security-opt=no-new-privileges", f"--user={STRANGER}")
BINARY = "application/octet-stream"


def run_command(containers: str, *words: str) -> str:
    """Returns what the command ``containers`` (podman or docker) prints for the arguments ``words``. Asserts that it
    succeeds."""
    run = subprocess.run([containers, *words], capture_output=True, text=True)
    assert run.returncode == 0, f"{' '.join(words)}: {run.stdout}{run.stderr}"
    return run.stdout.strip()


@contextmanager
def run_container(ask: partial[str], image: str, isa: str = "") -> Iterator[float]:
    """Runs a container of ``image`` while the block runs, with the engine for ``isa``. Yields the seconds [s] that it
    took to be ready. ``ask`` is ``run_command`` of podman or docker, here and below."""
    begin = time.monotonic()
    options = ("--detach", f"--name={NAME}", f"--publish=127.0.0.1:{PORT}:8000", f"--volume={VOLUME}:/data", *CAREFUL)
    ask("run", *options, "--env=DRAPE_OPEN=true", *([f"--env=DRAPE_ISA={isa}"] if isa else []), image)
    try:
        while not answer(PORT, "/readyz"):
            assert time.monotonic() - begin < 60.0, ask("logs", NAME)
            time.sleep(0.01)
        yield time.monotonic() - begin
    finally:
        ask("rm", "--force", NAME)


def look_at(ask: partial[str], image: str) -> None:
    """Asserts that the image is small, and that its user and its one volume are what the documents say."""
    (about,) = json.loads(ask("image", "inspect", image))
    print(f"image: {about['Size'] / 1e6:.0f} MB (target {SIZE_LIMIT / 1e6:.0f})", flush=True)
    assert about["Size"] <= SIZE_LIMIT
    assert about["Config"]["User"] not in ("", "root", "0") and list(about["Config"]["Volumes"]) == ["/data"]


def send_a_garment() -> str:
    """Uploads the shipped shirt as an OBJ file to the service, and returns the id of the garment that comes of it."""
    mesh = json.loads(answer(PORT, "/garments/tshirt/mesh"))
    lines = [f"v {x} {y} {z}" for x, y, z in mesh["vertices"]]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh["faces"]]
    job = json.loads(
        answer(PORT, "/garments?name=mine.obj&avatar=standard", "\n".join(lines).encode(), "application/octet-stream")
    )
    while job["state"] in ("queued", "running"):
        time.sleep(0.2)
        job = json.loads(answer(PORT, f"/jobs/{job['id']}"))
    assert job["state"] == "done", job
    return job["garment"]


def check_health(ask: partial[str], image: str) -> None:
    """Asserts that the image's own health check passes."""
    (about,) = json.loads(ask("image", "inspect", image))
    check = (about.get("Healthcheck") or about["Config"]["Healthcheck"])["Test"]  # podman's place, docker's
    assert check[0] == "CMD"
    ask("exec", NAME, *check[1:])


def end(ask: partial[str]) -> float:
    """Asserts that SIGTERM ends the container in good order and in time. Returns how long that takes [s]."""
    begin = time.monotonic()
    ask("stop", "--time=20", NAME)
    took = time.monotonic() - begin
    (about,) = json.loads(ask("container", "inspect", NAME))
    assert about["State"]["ExitCode"] in (0, 143), f"{about['State']}\n{ask('logs', NAME)}"
    assert took <= END_LIMIT_S, f"it ended after {took:.1f} s"
    return took


def main() -> None:
    """Tries the image that the command line names, and prints how large it is and how long it takes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("image")
    parser.add_argument("--containers", default="podman", metavar="COMMAND", help="podman (the default) or docker")
    options = parser.parse_args()
    ask, image = partial(run_command, options.containers), options.image
    look_at(ask, image)
    ask("volume", "create", VOLUME)
    try:
        with run_container(ask, image) as ready_s:
            print(f"image: ready after {ready_s:.1f} s (target {READY_TARGET_S:g}), {drape(PORT)} vertices", flush=True)
            check_health(ask, image)
            garment = send_a_garment()
            print(f"image: ended {end(ask):.1f} s after SIGTERM (target {END_LIMIT_S:g})", flush=True)
        with run_container(ask, image, OLDER) as ready_s:
            kept = [entry["id"] for entry in json.loads(answer(PORT, "/garments"))]
            assert garment in kept, f"{garment} is not among {kept}"
            print(f"image: an older processor: ready after {ready_s:.1f} s, {drape(PORT)} vertices, {garment} kept")
    finally:
        ask("volume", "rm", VOLUME)


if __name__ == "__main__":
    main()
