"""See ``benchmarks.latency``."""

from __future__ import annotations

import sys

from benchmarks.speed.latency import main
from drape.errors import ended

if __name__ == "__main__":
    sys.exit(ended(main))
