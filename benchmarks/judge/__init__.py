"""The judge: solvers that run until cloth is at rest, and the simulator of its motion. The product imports none."""
