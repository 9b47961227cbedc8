"""The command ``python -m benchmarks.referee``: how the physics optimum is reached."""
