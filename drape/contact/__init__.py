"""Keeping cloth out of the body: samples of the skin, what a garment's vertices know of them, and the push-out."""
