"""From a draped shape back to the sewing pattern; ``recovery.sim`` is the differentiable simulator."""
