"""The command ``python -m benchmarks.skin_pixels``: skin that shows through cloth."""
