"""The drape as physics itself: solvers that run until cloth is at rest, for clips without haste and for the judge.

``newton`` goes down to a place of rest, from where ``settling`` has brought the cloth; both work on the ``hessian`` and
the linear systems of ``linear``, and ``descent`` sweeps what is under the most force. ``apart`` does the same for cloth
that may not pass through itself. The body is met by ``blended_planes``.
"""
