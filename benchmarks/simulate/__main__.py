"""See ``benchmarks.simulate``."""

from __future__ import annotations

import sys

from benchmarks.speed.simulate import main

if __name__ == "__main__":
    sys.exit(main())
