"""How commands end that refuse: one sentence on standard error, and an exit status that scripts can tell."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import ParamSpec

from drape.errors import DrapeError

REFUSED_EXIT_CODE = 2

P = ParamSpec("P")


def refusing(main: Callable[P, int]) -> Callable[P, int]:
    """``main`` of a command, whose refusals (``DrapeError``) become their sentence and the status 2."""

    @functools.wraps(main)
    def guarded(*args: P.args, **kwargs: P.kwargs) -> int:
        try:
            return main(*args, **kwargs)
        except DrapeError as error:
            print(error, file=sys.stderr)
            return REFUSED_EXIT_CODE

    return guarded


def ended(main: Callable[[], object]) -> int:
    """Runs ``main``, which returns a record and no status: 0, or 2 after the sentence of its refusal."""

    def run() -> int:
        main()
        return 0

    return refusing(run)()
