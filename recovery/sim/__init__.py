"""Differentiable simulation of sewn garments over a body, float64, docs/explanation/recovery.md."""
