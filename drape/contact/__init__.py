"""Keeping cloth out of the body: skin samples, what a garment's vertices know of them, and the push itself."""
