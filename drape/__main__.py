"""``python -m drape``: the command ``drape``."""

from __future__ import annotations

import sys

from drape import installed
from drape.errors import Unavailable, refusing


@refusing
def main() -> int:
    """Runs the command line and returns its exit status: that of ``drape.command.main``, or 2 for an installation that
    is not whole, which is refused before its parts are imported.
    """
    installed.check()
    try:
        from drape.command import main as run
    except ModuleNotFoundError as error:
        expected = "the packages that the wheel of patchdrape asks for"
        raise Unavailable("drape", expected=expected, got=f"no {error.name}", cure=installed.AGAIN) from error
    return run()


if __name__ == "__main__":
    sys.exit(main())
