"""Cloth that moves: folds with a memory on the vertices, and swing by inertia on a coarse mesh."""
