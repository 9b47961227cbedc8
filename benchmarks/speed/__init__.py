"""Inputs and rivals of the speed benchmarks, and a service's clients that come and go."""
