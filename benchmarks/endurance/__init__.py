"""The command ``python -m benchmarks.endurance``: ``benchmarks.quality.endurance``."""
