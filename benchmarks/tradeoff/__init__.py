"""The command ``python -m benchmarks.tradeoff``: ``benchmarks.quality.tradeoff``."""
