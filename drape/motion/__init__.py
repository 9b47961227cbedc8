"""Motion clips: SMPL poses over time, read from files or generated; poses of rigs; spring bones."""
