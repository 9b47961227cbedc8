"""See ``benchmarks.recovery_targets``."""

from __future__ import annotations

import sys

from benchmarks.recovery.targets import main

if __name__ == "__main__":
    sys.exit(main())
