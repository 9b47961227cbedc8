"""Measures of a drape: energies beside physics, jitter, hems, crossings, and skin that shows."""
