"""What compiled code is made of: vectors and rows of them, the formulas of cloth, flat arrays, a grid of points."""
