"""The judge of accuracy. The product imports none of it; the solvers that both use are ``drape.exact``.

``physics`` finds the optimum of a drape from several starts, ``ipc_optimum`` that of cloth that may not pass through
itself, ``simulator`` that of every frame of a motion. ``physics_cache`` keeps optima on disk.
"""
