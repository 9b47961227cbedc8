"""Compiled pieces of the live solver: vectors, rows of lanes, elements, and a cloth as flat arrays; numba, no torch."""
