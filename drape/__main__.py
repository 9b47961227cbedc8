"""``python -m drape``: the command ``drape``."""

from __future__ import annotations

import sys

from drape.command import main

if __name__ == "__main__":
    sys.exit(main())
