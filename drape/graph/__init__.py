"""Inputs of the graphs: bodies, garments and outfits as arrays."""
