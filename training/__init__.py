"""Training of the network: data, losses, the loop, and what judges a checkpoint quickly."""
