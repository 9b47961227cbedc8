"""The swing of cloth by its own inertia, on a coarse mesh."""
