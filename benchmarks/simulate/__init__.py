"""The command ``python -m benchmarks.simulate``: ``benchmarks.speed.simulate``."""
