"""Fits a pattern to a draped target: open contours, linear grading, optimisation through the simulator."""
