"""The command ``python -m benchmarks.fabrics``: ``benchmarks.cloth.fabrics``."""
