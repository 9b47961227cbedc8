"""The local solver: energies of ``drape.cloth`` lowered vertex by vertex, with numba; no torch."""
