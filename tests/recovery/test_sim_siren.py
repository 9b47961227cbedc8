"""The network of sines: its derivatives, what a short training reaches, its file, and the option of the commands."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.errors import ArtifactError, InputError, MeshError
from recovery.drape.__main__ import main
from recovery.drape.pipeline import DistanceKind, DrapeOptions
from recovery.pattern.bases import skirt
from recovery.pattern.garmentcode import write_pattern
from recovery.run.__main__ import job_of, parse
from recovery.sim import siren
from recovery.sim.sdf import GridDistance, Sphere
from recovery.sim.siren import (
    SirenDistance,
    SirenError,
    SirenOptions,
    exact_distance,
    load_siren,
    siren_digest,
    siren_error,
    stored_siren,
)
from tests.drape.geometry.geometry_shapes import icosphere
from tests.recovery.pattern_setup import default_measurements

RADIUS_M = 0.1
CENTRE = (0.03, 1.0, -0.02)
SMALL = SirenOptions(width=32, layers=2, points=20_000, steps=500)
TINY = SirenOptions(width=16, layers=2, points=2000, steps=20)


@cache
def ball() -> tuple[np.ndarray, np.ndarray]:
    """A sphere off the origin; 0.1 mm inside the exact one at most."""
    vertices, faces = icosphere(5, radius_m=RADIUS_M)
    return vertices + CENTRE, faces


@cache
def trained() -> SirenDistance:
    with pytest.MonkeyPatch.context() as patch:  # a ball is smoother than a body
        for name, value in {"OMEGA": 3.0, "BATCH": 512, "RATE": 1e-2}.items():
            patch.setattr(siren, name, value)
        return SirenDistance.from_mesh(*ball(), SMALL)


def random_siren(seed: int = 0, *, width: int = 24, layers: int = 3) -> SirenDistance:
    """Weights of a trained network's size without the training: curved everywhere."""
    rng = np.random.default_rng(seed)
    sizes = [3, *[width] * layers, 1]
    weights = [rng.normal(size=(b, a)) * (3.0 if a == 3 else a**-0.5) for a, b in pairwise(sizes)]
    biases = [rng.normal(size=b) for b in sizes[1:]]
    return SirenDistance(weights, biases, np.array([-0.5, 0.0, -0.2]), np.array([0.5, 1.8, 0.2]), SirenError(0, 0, 0))


def points_in(found: SirenDistance, rng: np.random.Generator, count: int, *, outside: bool = False) -> torch.Tensor:
    low, high = found.low - 0.3 * outside, found.high + 0.3 * outside
    return torch.from_numpy(rng.uniform(low, high, size=(count, 3)))


@pytest.mark.parametrize("outside", [False, True])
def test_the_gradient_is_that_of_the_distance(rng, outside):
    found = random_siren()
    points = points_in(found, rng, 40, outside=outside)
    distance, gradient = found(points)
    assert distance.dtype == gradient.dtype == torch.float64
    leaf = points.clone().requires_grad_(True)
    (slope,) = torch.autograd.grad(found(leaf)[0].sum(), leaf)
    assert_allclose(gradient, slope, rtol=0, atol=1e-12 * float(slope.abs().max()))


def test_the_gradient_has_derivatives_backward_and_forward(rng):
    """Backward through it twice, the Jacobian along a vector by forward mode, and its symmetry: it is a Hessian."""
    found = random_siren()
    points = points_in(found, rng, 5)
    leaf = points.clone().requires_grad_(True)
    assert torch.autograd.gradcheck(lambda p: found(p)[1], leaf)
    assert torch.autograd.gradgradcheck(lambda p: found(p)[0], leaf)
    along = torch.from_numpy(rng.normal(size=points.shape))
    forward = torch.func.jvp(lambda p: found(p)[1], (points,), (along,))[1]
    (backward,) = torch.autograd.grad((found(leaf)[1] * along).sum(), leaf)
    assert_allclose(forward, backward, rtol=0, atol=1e-12 * float(forward.abs().max()))


def test_a_short_training_learns_a_sphere(rng):
    """Half a millimetre of a ball of 10 cm in 500 steps; the error that is told is the error there is."""
    found = trained()
    arm = rng.normal(size=(4000, 3))
    arm *= rng.uniform(RADIUS_M - 0.03, RADIUS_M + 0.03, size=(4000, 1)) / np.linalg.norm(arm, axis=1, keepdims=True)
    points = torch.from_numpy(arm + CENTRE)
    value, normal = Sphere(CENTRE, RADIUS_M)(points)
    error = siren_error(found, points.numpy(), value.numpy(), normal.numpy())
    assert error.mean_mm < 0.5 and error.p99_mm < 2.0 and error.angle_deg < 2.0, error
    assert_allclose(found.error.mean_mm, error.mean_mm, rtol=0.5)
    far = torch.tensor([[1.0, 1.0, 0.0], [0.03, -1.0, 0.1]], dtype=torch.float64)
    assert_allclose(found(far)[0], Sphere(CENTRE, RADIUS_M)(far)[0], rtol=0.1)


def test_the_same_seed_trains_the_same_network(monkeypatch):
    lines: list[str] = []
    first, second = (SirenDistance.from_mesh(*ball(), TINY, report=lines.append) for _ in range(2))
    monkeypatch.setattr(siren, "SEED", 1)
    other = SirenDistance.from_mesh(*ball(), TINY)
    for one, two in zip(first.weights + first.biases, second.weights + second.biases, strict=True):
        assert_array_equal(one, two)
    assert not np.array_equal(first.weights[0], other.weights[0])
    assert any("step 20 of 20" in line for line in lines) and any("mm off" in line for line in lines)


def test_exact_distances_have_the_normal_on_the_surface_and_off_it(rng):
    vertices, faces = ball()
    middles = vertices[faces].mean(axis=1)[::50]
    distance, normal = exact_distance(middles, vertices, faces)
    assert_allclose(distance, 0.0, atol=1e-12)
    outward = (middles - CENTRE) / np.linalg.norm(middles - CENTRE, axis=1, keepdims=True)
    assert_allclose((normal * outward).sum(axis=1), 1.0, atol=2e-3)
    for side in (-0.02, 0.02):
        distance, normal = exact_distance(middles + side * outward, vertices, faces)
        assert_allclose(distance, side, atol=2e-4)
        assert_allclose((normal * outward).sum(axis=1), 1.0, atol=2e-3)


# --- the file --------------------------------------------------------------------------------------------------------


def test_a_file_gives_the_same_bits_and_spares_the_training(tmp_path, rng):
    vertices, faces = ball()
    lines: list[str] = []
    first = stored_siren(vertices, faces, tmp_path, TINY, report=lines.append)
    assert lines
    lines.clear()
    again = stored_siren(vertices, faces, tmp_path, TINY, report=lines.append)
    assert not lines and again.error == first.error
    points = points_in(first, rng, 100, outside=True)
    for one, two in zip(first(points), again(points), strict=True):
        assert torch.equal(one, two)
    # Another body, or another training, is another file.
    stored_siren(1.01 * vertices, faces, tmp_path, TINY)
    assert len(list(tmp_path.glob("siren-*.npz"))) == 2
    own, others = siren_digest(vertices, faces, TINY), ((faces, SMALL), (faces[::-1], TINY))
    assert own not in [siren_digest(vertices, *other) for other in others]


def test_damaged_files_and_those_of_other_bodies_are_refused(tmp_path):
    path = tmp_path / "siren.npz"
    found = random_siren()
    found.save(path, "of this body")
    assert load_siren(path, "of this body").error == found.error
    with pytest.raises(ArtifactError, match="another body"):
        load_siren(path, "of that body")
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 0xFF
    for content in (b"", b"no archive", whole[: len(whole) // 2], bytes(flipped)):
        path.write_bytes(content)
        with pytest.raises(ArtifactError, match="trained distance"):
            load_siren(path, "of this body")


@pytest.mark.parametrize(
    "change",
    [
        {"weight_1": np.zeros((24, 7))},
        {"weight_3": np.zeros((2, 24)), "bias_3": np.zeros(2)},
        {"bias_0": np.full(24, np.nan)},
        {"high": np.full(3, -9.0)},
        {"low": np.zeros(2)},
        {"error": np.zeros(2)},
    ],
    ids=["a layer that does not follow", "two distances", "NaN", "no box", "no corner", "half an error"],
)
def test_files_that_hold_no_network_are_refused(tmp_path, change):
    path = tmp_path / "siren.npz"
    random_siren().save(path, "body")
    with np.load(path) as data:
        held = {name: data[name] for name in data.files}
    np.savez(path, **{**held, **change})
    with pytest.raises(ArtifactError, match="trained distance"):
        load_siren(path, "body")


def test_options_and_bodies_that_cannot_be_are_refused():
    vertices, faces = ball()
    with pytest.raises(MeshError, match="closed surface"):
        SirenDistance.from_mesh(vertices, faces[1:], SMALL)
    wrong: list[dict[str, Any]] = [{"steps": 0}, {"points": -1}, {"layers": 17}, {"width": 5000}]
    for numbers in wrong:
        with pytest.raises(InputError, match="siren options"):
            SirenOptions(**numbers)


# --- the option ------------------------------------------------------------------------------------------------------


def test_the_kind_decides_what_a_body_is_given_as(tmp_path):
    vertices, faces = ball()
    options = DrapeOptions(grid_m=0.04, siren=TINY, siren_folder=tmp_path)
    assert isinstance(options.skin(vertices, faces), GridDistance)
    assert not list(tmp_path.iterdir())
    chosen = replace(options, distance=DistanceKind.SIREN).skin(vertices, faces)
    assert isinstance(chosen, SirenDistance) and len(list(tmp_path.iterdir())) == 1


def test_the_option_reaches_a_recovery():
    words = ["scan.obj", "--base", "tshirt", "--out", "out"]
    assert job_of(parse(words)).drape.distance is DistanceKind.GRID
    drape = job_of(parse([*words, "--distance", "siren", "--siren-steps", "7", "--siren-folder", "there"])).drape
    assert (drape.distance, drape.siren.steps, drape.siren_folder) == (DistanceKind.SIREN, 7, Path("there"))


@pytest.mark.slow
def test_the_command_drapes_on_the_network_in_its_folder(tmp_path, monkeypatch, capsys):
    """Trained in the first run, written, and read in the second: where the file is damaged that one refuses."""
    body = load_body()
    pattern = tmp_path / "skirt.json"
    write_pattern(skirt(default_measurements()), pattern)
    quick = SirenOptions(width=64, layers=3, points=20_000, steps=250)
    monkeypatch.setattr("recovery.commands.DEFAULT_SIREN", quick)
    digest = siren_digest(body.v_template, body.faces, quick)
    out, folder = tmp_path / "out", tmp_path / "sirens"
    words = [str(pattern), "--out", str(out), "--edge-length", "0.08", "--iterations", "0", "--no-garment"]
    words += ["--distance", "siren", "--siren-folder", str(folder), "--siren-steps", "250"]
    assert main(words) == 3  # without Newton nothing is at rest
    assert "mm off within 3 cm" in capsys.readouterr().out
    found = load_siren(folder / f"siren-{digest[:16]}.npz", digest)
    report = json.loads(next(out.glob("*.json")).read_text())
    assert report["nodes"] > 0 and np.isfinite(report["rest"]["clearance_mm"])
    assert found.error.mean_mm < 10.0
    (folder / f"siren-{digest[:16]}.npz").write_bytes(b"damaged")
    assert main(words) == 2
    assert "trained distance" in capsys.readouterr().err
