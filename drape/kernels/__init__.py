"""The parts of compiled code: vectors and rows of them, the formulas of cloth, flat arrays, a grid of points."""
