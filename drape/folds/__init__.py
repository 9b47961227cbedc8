"""Folds with a memory: a few sweeps of the local solver on the network's drape, started from the frame before."""
