"""From a draped shape back to the sewing pattern.

``recovery.sim`` is the differentiable simulator; ``recovery.pattern`` reads, drafts, meshes and writes patterns.
"""
