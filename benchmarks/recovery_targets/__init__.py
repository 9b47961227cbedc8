"""The command ``python -m benchmarks.recovery_targets``: ``benchmarks.recovery.targets``."""
