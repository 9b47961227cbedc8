"""The judge of accuracy. The product imports none of it; the solvers that both use are ``drape.exact``.

``physics`` finds the optimum of a drape from several starts, ``ipc_optimum`` that of cloth that may not pass through
itself. ``physics_cache`` keeps optima on disk.
"""
