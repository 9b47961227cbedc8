"""A process of the intake that imports its libraries before there is a file.

``python -m service.uploads.spare_sandbox`` then reads a line of JSON, the arguments of ``service.uploads.sandbox``, and
goes on as that does. The imports take 0.9 s of a processor, which clients need not wait for.
"""

from __future__ import annotations

import json
import sys

from drape.forked import end_with_parent
from service.compute.background import step_back
from service.uploads import sandbox


def main() -> int:
    end_with_parent()
    step_back()
    import drape.avatar.own_garments
    import drape.body.assets
    import drape.garment.intake  # noqa: F401

    line = sys.stdin.buffer.readline()
    return sandbox.main(json.loads(line)) if line else 0


if __name__ == "__main__":
    sys.exit(main())
