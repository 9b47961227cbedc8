"""``python -m drape.live`` compiles the kernels of folds and swing and stores them, so that no service waits for it."""

from __future__ import annotations

from drape.live import fold_step, swing_step, two_level

fold_step.warm_up()
swing_step.warm_up()
two_level.warm_up()
