"""Runs the command ``drape`` by ``python -m drape``."""

from __future__ import annotations

import sys

from drape import installed
from drape.errors import Unavailable, refusing


@refusing
def main() -> int:
    """Runs the command line of the process and returns its exit status (``drape.command.main``). Refuses an
    installation that is not whole, before anything else is imported."""
    installed.check()
    try:
        from drape.command import main as run
    except ModuleNotFoundError as error:
        expected = "the packages that the wheel of patchdrape asks for"
        raise Unavailable("drape", expected=expected, got=f"no {error.name}", cure=installed.AGAIN) from error
    return run()


if __name__ == "__main__":
    sys.exit(main())
