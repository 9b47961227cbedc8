"""The engine gives what the kernels give, in float64 to its rounding, in float32 within a hundredth of a millimetre.

Compiling it takes the compiler out of a wheel, a download of 93 MB, so these tests are long ones.
"""

from __future__ import annotations

import ctypes
import math
from types import SimpleNamespace

import numpy as np
import pytest

from drape.engine.build import TARGETS, build, build_probe, host
from drape.engine.library import Scratch, empty_points, load
from drape.engine.records import Record
from drape.exact import descent, hessian
from drape.kernels.quantised import quantise
from drape.live.fold_step import FoldEffort, fold
from tests.drape.kernels.solver_setup import crumpled
from tests.drape.live import folds_setup

pytestmark = pytest.mark.long
SUFFIXES = {np.float32: "f32", np.float64: "f64"}
TYPES = pytest.mark.parametrize("dtype", [np.float64, np.float32])


@pytest.fixture(scope="module")
def engine(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    folder = tmp_path_factory.mktemp("engine")
    build_probe(host(), folder)
    for target in TARGETS[host()]:
        build(target, folder, doubles=True)
    return load(doubles=True, folder=folder)


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def at(record: Record) -> ctypes.c_void_p:
    return ctypes.c_void_p(record.address)


class Outcome(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_int64) for name in ("settled", "reset", "lost", "turn")),
        *((name, ctypes.c_double) for name in ("untangle_m", "lifted_share", "lifted_max_m")),
    ]


def memory(places: int, dtype: type[np.floating]) -> SimpleNamespace:
    room = {name: empty_points(places, dtype) for name in ("network", "residual", "velocity", "grip")}
    samples = {name: np.zeros(places, np.int32) for name in ("own", "other")}
    return SimpleNamespace(**room, **samples, added=empty_points(0, dtype), turn=0, step_s=math.inf)


def folded_by(engine, made, frames, effort, dtype) -> list[tuple[np.ndarray, Outcome]]:
    cloth, scratch = Record("FoldConstants", made, dtype), Scratch(64 << 20)
    past, found = memory(len(made.sheet.vertex), dtype), []
    for one in frames:
        after, vertices = memory(len(made.sheet.vertex), dtype), empty_points(len(one.vertices), dtype)
        vertices[:] = one.vertices
        around = SimpleNamespace(skin=np.ascontiguousarray(one.skin, dtype), colliders=np.zeros((0, 16)))
        records = [
            Record(name, value, dtype)
            for name, value in (
                ("FoldMemory", past),
                ("Surroundings", around),
                ("FoldEffort", effort),
                ("FoldMemory", after),
            )
        ]
        out, outcome = np.empty_like(vertices), Outcome()
        scratch.used = 0
        failed = getattr(engine, f"drape_fold_{SUFFIXES[dtype]}")(
            pointer(vertices), at(records[0]), at(records[1]), at(cloth), at(records[2]), at(records[3]), pointer(out),
            ctypes.byref(outcome), ctypes.byref(scratch),
        )  # fmt: skip
        assert not failed
        after.turn, after.step_s = outcome.turn, 1.0 / 30.0
        past = after
        found.append((out, outcome))
    return found


@TYPES
@pytest.mark.parametrize(
    "effort", [folds_setup.EFFORT, folds_setup.HELD, FoldEffort(steps=0), FoldEffort(3, 8, True, 0.0)]
)
@pytest.mark.parametrize("material", ["rib", "denim"])
def test_folds_are_those_of_the_kernels(engine, material, effort, dtype):
    rest, _ = folds_setup.sleeve(material)
    made = folds_setup.constants(material, dtype=dtype)
    frames = [folds_setup.frame(rest, number) for number in range(6)]
    past = None
    for one, (found, outcome) in zip(frames, folded_by(engine, made, frames, effort, dtype), strict=True):
        expected, past, report = fold(made, past, one, effort)
        assert np.abs(found - expected).max() < (1e-11 if dtype is np.float64 else 1e-5)
        assert (outcome.settled, outcome.reset) == (report.settled, report.reset)
        assert outcome.lifted_share == pytest.approx(report.lifted_share, abs=1e-3)


def test_steps_of_positions_are_those_of_the_kernels(engine):
    points = np.random.default_rng(0).normal(size=(1001, 3)).astype(np.float32)
    expected, low, size = quantise(points)
    steps, box = np.empty(points.shape, np.uint16), np.empty((2, 3), np.float32)
    engine.drape_quantise(
        pointer(points), ctypes.c_int64(len(points)), ctypes.c_float(65535), pointer(steps), pointer(box)
    )
    assert np.array_equal(steps, expected)
    assert np.array_equal(box, [low, size])


def test_energy_sweeps_and_hessian_of_physics_are_those_of_the_kernels(engine):
    scene = crumpled()
    problem, around = Record("Problem", scene.problem, np.float64), Record("Around", scene.around, np.float64)
    given, count = (at(problem), at(around)), len(scene.x)

    expected, found = np.empty_like(scene.x), np.empty_like(scene.x)
    energy = descent.energy_and_gradient(scene.x, scene.problem, scene.around, expected)
    engine.drape_energy_f64.restype = ctypes.c_double
    assert engine.drape_energy_f64(pointer(scene.x), *given, pointer(found)) == pytest.approx(energy, rel=1e-12)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)

    for guarded in (False, True):
        expected, found = scene.x.copy(), empty_points(count, np.float64)
        found[:] = scene.x
        descent.sweep(expected, scene.problem, scene.around, guarded)
        order = pointer(scene.problem.order)
        engine.drape_sweep_f64(pointer(found), *given, order, ctypes.c_int64(count), ctypes.c_int(guarded))
        assert np.abs(found - expected).max() < 1e-11

    expected, found = np.empty((count, 3, 3)), np.empty((count, 3, 3))
    descent.diagonal_blocks(scene.x, scene.problem, scene.around, expected)
    engine.drape_diagonal_f64(pointer(scene.x), *given, pointer(found))
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)

    pattern = hessian.pattern(scene.cloth)
    expected, found = np.empty((len(pattern.column), 3, 3)), np.empty((len(pattern.column), 3, 3))
    for exact in (0.0, 0.5, 1.0):
        hessian.assemble(scene.x, scene.problem, scene.around, pattern, exact, expected)
        where = at(record := Record("Pattern", pattern, np.float64))
        engine.drape_hessian_f64(pointer(scene.x), *given, where, ctypes.c_double(exact), pointer(found))
        assert found == pytest.approx(expected, rel=1e-8, abs=1e-8), record
