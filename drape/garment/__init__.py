"""Garments: mesh files taken in, patches and charts that cover them, their cloth at rest, and what is kept of them."""
