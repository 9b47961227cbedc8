"""``python -m drape.live``: compiles the kernels of folds where they are not yet stored, so that no service waits."""

from __future__ import annotations

from drape.live.fold_step import warm_up

warm_up()
