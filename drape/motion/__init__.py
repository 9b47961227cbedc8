"""Motion clips: SMPL poses over time, read from AMASS and BVH files or generated."""
