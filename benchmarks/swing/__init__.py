"""``python -m benchmarks.swing``."""
