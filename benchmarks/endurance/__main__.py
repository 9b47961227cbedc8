"""See ``benchmarks.endurance``."""

from __future__ import annotations

import sys

from benchmarks.quality.endurance import main
from drape.errors import ended

if __name__ == "__main__":
    sys.exit(ended(main))
