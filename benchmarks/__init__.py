"""Measurements of the product, by subject: ``python -m benchmarks.NAME``."""
