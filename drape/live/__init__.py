"""Cloth that moves from frame to frame: folds on the vertices, and swing by inertia on a coarse mesh."""
