"""A process of the intake that has read its libraries before a file is there.

``python -m service.uploads.spare_sandbox`` reads a line of JSON, the arguments of ``service.uploads.sandbox``, and goes
on as that does. Its libraries take 0.9 s of a processor, which whoever drops a file does not wait for.
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
