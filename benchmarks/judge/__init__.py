"""The judge: solvers that run until cloth is at rest, over the core alone. The product imports none of it.

``physics`` finds the optimum of a drape by ``newton``, from where ``settling`` has brought it; both work on the
``hessian`` and the linear systems of ``linear``, and ``descent`` sweeps what is under the most force. ``ipc_optimum``
does the same for cloth that may not pass through itself, ``simulator`` for every frame of a motion. All of them meet
the body by ``blended_planes``. ``physics_cache`` keeps optima on disk.
"""
