"""The command ``python -m benchmarks.serving``: ``benchmarks.speed.serving``."""
