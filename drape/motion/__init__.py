"""Motion clips: SMPL poses over time, read from AMASS, BVH and ASF/AMC files or generated."""
