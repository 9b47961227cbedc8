"""Bodies for tests: a small random one, and pickles laid out as SMPL's licensed files are."""

from __future__ import annotations

import io
import pickle
import sys
import types
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import scipy.sparse

from drape.body.skeleton import JOINT_COUNT, PARENTS

VERTEX_COUNT = 60


def smpl_arrays(rng: np.random.Generator, *, posedirs: bool = False) -> dict[str, Any]:
    """A random body of 60 vertices in SMPL's schema and dtypes: sparse regressor, root's parent 2^32 - 1."""
    regressor = np.where(rng.random((JOINT_COUNT, VERTEX_COUNT)) < 0.2, rng.random((JOINT_COUNT, VERTEX_COUNT)), 0.0)
    regressor[:, 0] += 0.1
    arrays = {
        "v_template": rng.normal(size=(VERTEX_COUNT, 3)),
        "shapedirs": 0.01 * rng.normal(size=(VERTEX_COUNT, 3, 10)),
        "J_regressor": scipy.sparse.csc_matrix(regressor / regressor.sum(axis=1, keepdims=True)),
        "weights": rng.dirichlet(np.ones(JOINT_COUNT), VERTEX_COUNT),
        "kintree_table": np.array([[2**32 - 1, *PARENTS[1:]], range(JOINT_COUNT)], dtype=np.uint32),
        "f": rng.integers(0, VERTEX_COUNT, (100, 3)).astype(np.uint32),
    }
    if posedirs:
        arrays["posedirs"] = 0.01 * rng.normal(size=(VERTEX_COUNT, 3, 9 * (JOINT_COUNT - 1)))
    return arrays


class PythonTwoPickler(pickle._Pickler):
    """Writes what Python 2 wrote: protocol 2, text and bytes alike as byte strings, modules under their old names."""

    dispatch: ClassVar[dict] = dict(pickle._Pickler.dispatch)
    write: Callable[[bytes], None]
    memoize: Callable[[Any], None]

    def save_string(self, text: str | bytes) -> None:
        payload = text.encode("latin1") if isinstance(text, str) else text
        self.write(pickle.BINSTRING + len(payload).to_bytes(4, "little") + payload)
        self.memoize(text)

    dispatch[str] = save_string
    dispatch[bytes] = save_string


def python_two_pickle(value: Any) -> bytes:
    """``value`` as a pickle from the time of SMPL's release."""
    stream = io.BytesIO()
    PythonTwoPickler(stream, protocol=2).dump(value)
    payload = stream.getvalue()
    for new, old in ((b"numpy._core.", b"numpy.core."), (b"scipy.sparse._csc", b"scipy.sparse.csc")):
        payload = payload.replace(b"c" + new, b"c" + old)
    return payload


def pickled_with_chumpy(arrays: dict[str, Any], *wrapped: str, dump=python_two_pickle) -> bytes:
    """``arrays`` pickled with those named ``wrapped`` as objects of a class ``chumpy.ch.Ch``.

    The state is that of chumpy's ``__getstate__``. The module exists only while the file is written.
    """
    module = types.ModuleType("chumpy.ch")
    ch = type("Ch", (), {"__module__": "chumpy.ch"})
    module.__dict__["Ch"] = ch
    shells = {}
    for key in wrapped:
        shells[key] = ch()
        state = {"_dirty_vars": {"x"}, "_itr": None, "_make_dense": False, "_depends_on_deps": {}, "x": arrays[key]}
        vars(shells[key]).update(state)
    sys.modules.update({"chumpy": types.ModuleType("chumpy"), "chumpy.ch": module})
    try:
        return dump({**arrays, **shells})
    finally:
        del sys.modules["chumpy"], sys.modules["chumpy.ch"]
