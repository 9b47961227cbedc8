"""``python -m drape.folds``: compiles the kernels of folds where they are not yet stored, so that no service waits."""

from __future__ import annotations

from drape.folds.step import warm_up

warm_up()
