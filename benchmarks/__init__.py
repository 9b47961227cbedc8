"""Measurements of the product, by subject, and repeats of the papers' tables: ``python -m benchmarks.NAME``."""
