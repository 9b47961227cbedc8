"""Who reads what a service writes may stall, go away, or have no room: the service goes on, and lines are counted."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from service.settings import Settings
from service.watch.outputs import KEPT_BYTES
from tests.architecture.repository import ROOT
from tests.fixtures.patience import wait_until

LINES = 2000  # of each output, together some times what a pipe and the process of the outputs keep
FEW_LINES = 100  # which a pipe keeps, so that none is lost to a reader who is late
DEADLINE_S = 120.0

# Writes in every way there is, says so in a file, and once more when it is told to by a line.
WRITER = """
import faulthandler, logging, os, pathlib, subprocess, sys, warnings
from service.watch.logs import set_up
from service.watch.outputs import dropped_lines, free_outputs
set_up("json")
free_outputs("json")
log = logging.getLogger("drape.test")
for number in range(int(sys.argv[2])):
    log.info("%d %s", number, "x" * 200)
    print("x" * 200)
print(flush=True)
faulthandler.dump_traceback()
warnings.warn("once")
subprocess.run([sys.executable, "-c", "import sys; sys.stderr.write('y' * 9 + chr(10)); print('y' * 9)"], check=True)
told = pathlib.Path(sys.argv[1])
told.with_suffix(".new").write_text(str(dropped_lines()))
told.with_suffix(".new").replace(told)
sys.stdin.readline()
log.info("again")
print("again", flush=True)
"""


def writing(told: Path, *limits: str, stdout: int, stderr: int, lines: int = LINES) -> subprocess.Popen[str]:
    command = [*limits, sys.executable, "-c", WRITER, str(told), str(lines)]
    return subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, text=True, stdout=stdout, stderr=stderr)


def counted(lines: list[str]) -> tuple[int, int]:
    """How many of ``lines`` are no word about others, and how many they say are missing."""
    said = [re.search(r'"(\d+) lines were dropped', line) for line in lines]
    return sum(one is None for one in said), sum(int(one[1]) for one in said if one is not None)


def test_a_reader_that_stalls_loses_lines_and_is_told_how_many(tmp_path: Path):
    told = tmp_path / "told"
    with writing(told, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as writer:
        wait_until(told.exists, DEADLINE_S)  # nobody has read a byte
        assert int(told.read_text()) > LINES
        assert writer.stdin is not None and writer.stdout is not None and writer.stderr is not None
        readers = [os.fdopen(os.dup(one.fileno())) for one in (writer.stdout, writer.stderr)]
        for reader in readers:  # until lines flow again
            for line in reader:
                if "lines were dropped" in line:
                    break
        writer.stdin.write("\n")
        out, errors = writer.communicate(timeout=DEADLINE_S)
    assert writer.returncode == 0
    assert out.splitlines()[-1] == "again" and json.loads(errors.splitlines()[-1])["message"] == "again"
    assert "yyyyyyyyy" in out and "yyyyyyyyy" in errors and "UserWarning: once" in errors and "most recent" in errors


@pytest.mark.parametrize("mode", ["whole", "stalled"])
def test_what_is_read_and_what_is_told_missing_is_all_there_was(tmp_path: Path, mode: str):
    told, errors, lines = tmp_path / "told", tmp_path / "errors", LINES if mode == "stalled" else FEW_LINES
    with errors.open("wb") as file, writing(told, stdout=subprocess.PIPE, stderr=file.fileno(), lines=lines) as writer:
        assert writer.stdin is not None and writer.stdout is not None
        before = [] if mode == "stalled" else list(iter(writer.stdout.readline, "\n"))
        wait_until(told.exists, DEADLINE_S)
        with writer.stdin:
            writer.stdin.write("\n")
        out = writer.stdout.read()  # what was read ahead of the empty line is in it
    read, missing = counted([*before, *out.splitlines()])
    assert (missing > 0) == (mode == "stalled")
    assert read + missing == lines + 2 + (mode == "stalled"), "lines, an empty one, a child's, and the last"
    assert counted(errors.read_text().splitlines())[1] == 0
    assert len([line for line in errors.read_text().splitlines() if "drape.test" in line]) == lines + 1


def test_a_full_disk_a_limit_of_files_and_a_reader_that_left_are_no_reason_to_end(tmp_path: Path):
    limited, full = tmp_path / "limited", os.open("/dev/full", os.O_WRONLY)
    reader, left = os.pipe()
    os.close(reader)
    for number, output in enumerate((full, left, os.open(limited, os.O_WRONLY | os.O_CREAT))):
        told = tmp_path / f"told{number}"
        limits = ["prlimit", "--fsize=20480"] if number == 2 else []
        with writing(told, *limits, stdout=output, stderr=output) as writer:
            os.close(output)
            writer.communicate("\n", timeout=DEADLINE_S)
        assert writer.returncode == 0
        assert int(told.read_text()) > LINES
    assert limited.stat().st_size <= 20480


def test_a_service_whose_log_nobody_reads_answers_and_ends(make_settings: Callable[..., Settings]):
    chosen = make_settings().model_dump(mode="json", exclude_unset=True)
    environment = {**os.environ, **{f"DRAPE_{name.upper()}": str(value) for name, value in chosen.items()}}
    command = [sys.executable, "-m", "service", "--port", "0"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=ROOT, env=environment, stdout=pipe, stderr=pipe, text=True) as service:
        assert service.stdout is not None
        try:
            with httpx.Client(base_url=service.stdout.readline().split()[2], timeout=DEADLINE_S) as client:
                for _ in range(2 * (KEPT_BYTES + 65536) // 400):
                    assert client.get("/garments/" + "x" * 190, headers={"X-Request-Id": "y" * 64}).status_code == 404
                found = re.search(r"^drape_log_dropped_lines_total (\S+)", client.get("/metrics").text, re.MULTILINE)
            assert found is not None and float(found[1]) > 0.0
            service.send_signal(signal.SIGTERM)
            service.wait(DEADLINE_S)
        finally:
            service.kill()
