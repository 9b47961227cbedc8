"""The command ``python -m benchmarks.folds``: ``benchmarks.quality.folds``."""
