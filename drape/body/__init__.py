"""The body: its model, its files, and the descriptors of its pose that networks read."""
