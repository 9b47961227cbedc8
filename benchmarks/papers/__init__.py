"""Repeats of the papers' tables and figures, and what only they need."""
