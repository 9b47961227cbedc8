"""Cloth out of the body: samples of skin and cloth, their signed distance, tables of garments, and the push-out."""
