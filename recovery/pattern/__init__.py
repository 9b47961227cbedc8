"""Sewing patterns: panels, edges and stitches; reading, meshing and writing them, docs/guide/patterns.md."""
