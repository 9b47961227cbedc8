"""Reads, verifies and writes body parameter files in the SMPL schema.

A body is ``NAME.npz`` (``v_template, shapedirs, J_regressor, weights,
kintree_table, f``, optional ``posedirs``) beside ``NAME.json`` (source, licence,
sha256). Licensed SMPL files, ``.npz`` or ``.pkl``, load unchanged; pickles go
through an unpickler that builds arrays and nothing else.
"""

from __future__ import annotations

import hashlib
import io
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse

from drape.arrays import check_finite, check_shape
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT, PARENTS
from drape.errors import ArtifactError, BodyError, NotFound
from drape.files.atomic import whole_file
from drape.files.packed import UNREADABLE
from drape.folders import ASSETS

BODIES_DIR = ASSETS / "bodies"
DEFAULT_BODY = "anny_default"
SHAPE_LIMIT = 10
POSE_COUNT = 9 * (JOINT_COUNT - 1)  # Pose blend shapes read so many entries of the local rotations.
REQUIRED = ("v_template", "shapedirs", "J_regressor", "weights", "kintree_table", "f")


def save_body(
    stem: Path,
    *,
    v_template: np.ndarray,
    shapedirs: np.ndarray,
    J_regressor: scipy.sparse.spmatrix | np.ndarray,
    weights: np.ndarray,
    f: np.ndarray,
    about: dict[str, Any],
) -> None:
    """Writes the body's arrays to ``stem.npz``, lengths in metres, and ``about`` with the file's sha256 to
    ``stem.json``. A reader sees each file whole. ``v_template`` (V, 3), ``shapedirs`` (V, 3, S), ``J_regressor``
    (24, V), ``weights`` (V, 24), ``f`` (F, 3)."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    regressor = scipy.sparse.csr_matrix(J_regressor)
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        v_template=v_template.astype(np.float32),
        shapedirs=shapedirs.astype(np.float32),
        J_regressor=regressor.toarray().astype(np.float32),
        weights=weights.astype(np.float32),
        kintree_table=np.array([PARENTS, range(JOINT_COUNT)], dtype=np.int32),
        f=f.astype(np.int32),
    )
    payload = buffer.getvalue()
    with whole_file(stem.with_suffix(".npz")) as file:
        file.write(payload)
    record = {**about, "sha256": hashlib.sha256(payload).hexdigest()}
    with whole_file(stem.with_suffix(".json")) as file:
        file.write((json.dumps(record, indent=1) + "\n").encode())


def list_bodies(folder: Path = BODIES_DIR) -> list[str]:
    """Returns the sorted names of the bodies in ``folder``. JSON files without a digest, such as the table of avatars,
    are no bodies."""
    return sorted(path.stem for path in folder.glob("*.json") if "sha256" in json.loads(path.read_text("utf-8")))


def load_body(source: str | Path = DEFAULT_BODY) -> BodyModel:
    """Returns the body at ``source``: the name of a shipped one, or an SMPL-schema file ``.npz`` or ``.pkl``.

    Raises ``NotFound`` for an unknown name, ``ArtifactError`` when a shipped file does not match its hash, and
    ``BodyError`` when the contents are not a body.
    """
    path = Path(source)
    if path.suffix not in (".npz", ".pkl"):
        path = BODIES_DIR / f"{source}.npz"
    if not path.is_file():
        raise NotFound(
            "body",
            expected=f"one of {', '.join(list_bodies())}, or a file .npz or .pkl",
            got=str(source),
            cure="Check the name or the path.",
        )
    payload = path.read_bytes()
    digest = hashlib.sha256(payload).hexdigest()
    record = path.with_suffix(".json")
    if path.suffix == ".npz" and record.is_file():
        stored = _recorded_digest(record)
        if stored != digest:
            raise ArtifactError(
                f"{path.name}", expected=f"sha256 {stored}", got=digest, cure="Restore the file or bake it again."
            )
    arrays = _read_pickle(payload, path.name) if path.suffix == ".pkl" else _read_npz(payload, path.name)
    return body_from_arrays(arrays, name=path.stem, digest=digest)


def _recorded_digest(record: Path) -> str:
    try:
        return str(json.loads(record.read_text())["sha256"])
    except (ValueError, KeyError, TypeError) as error:
        raise ArtifactError(
            record.name, expected="a JSON object with sha256", got=str(error), cure="Restore the file or bake it again."
        ) from error


def body_from_arrays(arrays: dict[str, np.ndarray], *, name: str, digest: str) -> BodyModel:
    """Returns the body of SMPL-schema ``arrays``, in float64 with at most ten shapes. Raises ``BodyError`` where they
    do not fit together."""
    missing = [key for key in REQUIRED if key not in arrays]
    if missing:
        raise _fault(name, f"the arrays {', '.join(REQUIRED)}", f"no {', '.join(missing)}")
    template = _dense(arrays, "v_template", name=name)
    check_shape(f"body {name} v_template", template, (None, 3), error=BodyError)
    count = len(template)
    if count == 0:
        raise _fault(f"{name} v_template", "vertices", "shape (0, 3)")
    dense = {key: _dense(arrays, key, name=name) for key in ("shapedirs", "weights", "f", "kintree_table")}
    if arrays.get("posedirs") is not None:
        dense["posedirs"] = _dense(arrays, "posedirs", name=name)
    regressor = _regressor(arrays["J_regressor"], name=name)
    wanted: dict[str, tuple[int | None, ...]] = {
        "shapedirs": (count, 3, None),
        "weights": (count, JOINT_COUNT),
        "J_regressor": (JOINT_COUNT, count),
        "f": (None, 3),
        "kintree_table": (2, JOINT_COUNT),
        "posedirs": (count, 3, POSE_COUNT),
    }
    for key, array in {**dense, "J_regressor": regressor}.items():
        check_shape(f"body {name} {key}", array, wanted[key], error=BodyError)
    for key, array in {"v_template": template, **dense, "J_regressor": regressor.data}.items():
        check_finite(f"body {name} {key}", array, error=BodyError)
    weights, posedirs = dense["weights"], dense.get("posedirs")
    faces, tree = dense["f"].astype(np.int64), dense["kintree_table"].astype(np.int64)
    if faces.size and (faces.min() < 0 or faces.max() >= count):
        raise _fault(f"{name} f", f"indices in [0, {count})", f"[{faces.min()}, {faces.max()}]", "Repair the file.")
    parents = tree[0].copy()
    parents[0] = -1  # SMPL stores the root's parent as 2^32 - 1
    if tuple(parents) != PARENTS:
        got = str(tuple(parents.tolist()))
        raise _fault(f"{name} kintree_table", "SMPL's 24-joint tree", got, "Use a 24-joint SMPL body.")
    total = weights.sum(axis=1, keepdims=True)
    if np.abs(total - 1.0).max() > 1e-3 or weights.min() < -1e-6:
        got = f"sums in [{total.min():.4g}, {total.max():.4g}]"
        raise _fault(f"{name} weights", "rows >= 0 that sum to 1", got, "Normalise the weights.")
    return BodyModel(
        name=name,
        digest=digest,
        v_template=template,
        shapedirs=dense["shapedirs"][..., :SHAPE_LIMIT],
        regressor=regressor,
        weights=weights / total,
        faces=faces,
        posedirs=posedirs,
    )


def _fault(name: str, expected: str, got: str, cure: str = "Use an SMPL-schema file.") -> BodyError:
    return BodyError(f"body {name}", expected=expected, got=got, cure=cure)


def _dense(arrays: dict[str, Any], key: str, *, name: str) -> np.ndarray:
    try:
        return np.asarray(arrays[key], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise _fault(f"{name} {key}", "an array of numbers", str(error)) from error


def _regressor(value: Any, *, name: str) -> scipy.sparse.csr_matrix:
    try:
        if scipy.sparse.issparse(value):
            value.check_format(full_check=True)  # an unpickled matrix may point outside its own arrays
        return scipy.sparse.csr_matrix(value, dtype=np.float64)
    except (TypeError, ValueError, AttributeError, IndexError) as error:
        raise _fault(f"{name} J_regressor", "a matrix of numbers", str(error)) from error


def _read_npz(payload: bytes, name: str) -> dict[str, np.ndarray]:
    try:
        with np.load(io.BytesIO(payload), allow_pickle=False) as stored:
            return {key: stored[key] for key in stored.files if key in (*REQUIRED, "posedirs")}
    except UNREADABLE as error:
        raise BodyError(
            name, expected="an npz of plain arrays", got=str(error), cure="Export the body without pickled objects."
        ) from error


class _ArrayUnpickler(pickle.Unpickler):
    """Builds numpy arrays, SciPy sparse matrices and chumpy's array shells; looks up nothing else."""

    ALLOWED = frozenset(
        {
            ("numpy", "ndarray"),
            ("numpy", "dtype"),
            ("numpy.core.multiarray", "_reconstruct"),
            ("numpy._core.multiarray", "_reconstruct"),
            ("numpy.core.multiarray", "scalar"),
            ("numpy._core.multiarray", "scalar"),
            ("scipy.sparse.csc", "csc_matrix"),
            ("scipy.sparse._csc", "csc_matrix"),
            ("scipy.sparse.csr", "csr_matrix"),
            ("scipy.sparse._csr", "csr_matrix"),
            ("copyreg", "_reconstructor"),
            ("copy_reg", "_reconstructor"),
            ("__builtin__", "object"),
            ("builtins", "object"),
            ("__builtin__", "set"),  # chumpy keeps the names of its stale variables in one
            ("builtins", "set"),
            ("numpy.core.numeric", "_frombuffer"),  # Pickles of protocol 5 make arrays by it.
            ("numpy._core.numeric", "_frombuffer"),
        }
    )

    def find_class(self, module: str, name: str) -> Any:
        if module.startswith("chumpy"):
            return _ChumpyShell  # SMPL's released pickles wrap some arrays in chumpy objects
        if (module, name) == ("_codecs", "encode"):
            return _latin1_bytes  # Python 3 writes bytes so for protocol 2.
        if (module, name) not in self.ALLOWED:
            raise pickle.UnpicklingError(f"the file asks for {module}.{name}")
        if module.startswith("scipy.sparse."):
            module = "scipy.sparse"  # The old submodules end with SciPy 2.
        return super().find_class(module.replace("copy_reg", "copyreg").replace("__builtin__", "builtins"), name)


class _ChumpyShell:
    """Takes the state of a pickled chumpy object; its array is the entry ``x``."""

    def __new__(cls, *arguments: Any) -> _ChumpyShell:
        shell = super().__new__(cls)
        shell.state = {}
        return shell

    def __init__(self, *arguments: Any) -> None:
        self.state: dict[str, Any]

    def __setstate__(self, state: Any) -> None:
        self.state = state if isinstance(state, dict) else {}


def _latin1_bytes(text: str, encoding: str) -> bytes:
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"the file asks for the codec {encoding}")
    return text.encode("latin1")


def _read_pickle(payload: bytes, name: str) -> dict[str, np.ndarray]:
    try:
        stored = _ArrayUnpickler(io.BytesIO(payload), encoding="latin1").load()
    except Exception as error:
        # A hostile or broken pickle can raise anything while it is read.
        raise BodyError(
            name,
            expected="a pickled dictionary of arrays",
            got=str(error),
            cure="Use an SMPL .pkl or convert it to .npz.",
        ) from error
    if not isinstance(stored, dict):
        raise BodyError(
            name, expected="a pickled dictionary of arrays", got=type(stored).__name__, cure="Use an SMPL .pkl."
        )
    arrays: dict[str, Any] = {}
    for key, value in stored.items():
        value = value.state.get("x", value.state.get("a")) if isinstance(value, _ChumpyShell) else value
        if isinstance(value, np.ndarray) or scipy.sparse.issparse(value):
            arrays[str(key)] = value
    return arrays
