"""``drape doctor``."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import numpy as np

from drape.doctor import folded, swatch


def told(**environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "drape", "doctor"]
    return subprocess.run(command, capture_output=True, text=True, env=os.environ | environment)


def test_it_tells_processor_engine_and_threads_and_passes_its_own_test():
    answer = told()
    assert answer.returncode == ("wrong:" in answer.stdout), answer.stderr
    lines = dict(line.split(": ", 1) for line in answer.stdout.splitlines())
    assert lines["engine"].startswith("engine-") and int(lines["threads"]) >= 1 and lines["processor"]
    assert re.match(r"[1-9]\d* frames of a swatch of 441 vertices in 0.5 s, and the same again", lines["self-test"])


def test_it_tells_whether_garments_can_be_written_where_the_service_keeps_them(tmp_path):
    kept = tmp_path / "garments"
    assert f"garments of users: {kept}\n" in told(DRAPE_GARMENTS_DIR=str(kept)).stdout
    kept.write_text("a file")
    answer = told(DRAPE_GARMENTS_DIR=str(kept))
    assert answer.returncode == 1 and f"{kept} cannot be written: set DRAPE_GARMENTS_DIR" in answer.stdout


def test_what_no_library_is_made_for_is_refused_in_a_sentence():
    answer = told(DRAPE_ISA="v9")
    assert answer.returncode == 2
    assert answer.stderr.startswith("processor: expected x86-64 of level v2, v3 or v4")


def test_the_swatch_hangs_from_its_edge_and_keeps_its_size():
    constants, vertices = swatch()
    found, frames = folded(constants, vertices, 60, np.inf)
    assert frames == 60
    upper = vertices[:, 1] > vertices[:, 1].max() - 0.005
    assert np.abs(found - vertices)[upper].max() < 0.0105  # a leash of a centimetre, and its spring beyond
    edge_m = np.linalg.norm(np.diff(found.reshape(21, 21, 3), axis=1), axis=-1)
    assert edge_m.min() > 0.008 and edge_m.max() < 0.012
