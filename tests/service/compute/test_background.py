"""What a service's process gives back to the system."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

PROGRAM = """
import numpy as np
from service.compute.background import give_back_memory
{call}
def resident_mb():
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 1e6
np.ones(1 << 20)  # glibc takes what is freed for the size of what comes
before, large, small = resident_mb(), [], []
for _ in range(40):
    large.append(np.ones(1 << 19))
    small.append(np.ones(1000))
del large
print(resident_mb() - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="Another C library: nothing is asked of it.")
def test_large_arrays_between_small_ones_are_given_back():
    kept_mb = []
    for call in ("", "give_back_memory()"):
        command = [sys.executable, "-c", PROGRAM.format(call=call)]
        kept_mb.append(float(subprocess.run(command, capture_output=True, text=True, check=True).stdout))
    assert kept_mb[0] > 100 > 10 > kept_mb[1], kept_mb
