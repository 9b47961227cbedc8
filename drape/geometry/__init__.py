"""Geometry without garments: rotations, jets, meshes, nearest points, skinning, and pictures of triangles."""
