"""The command ``python -m benchmarks.latency``: ``benchmarks.speed.latency``."""
