"""Laws of PolyFit: exact fits, invariances of the networks, ranges of the families, resuming."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from benchmarks.papers.polyfit import families, fit
from benchmarks.papers.polyfit.canonical import canonical
from benchmarks.papers.polyfit.garment_patches import (
    NamedGarment,
    draw_garment_patches,
    held_out_garments,
    sample_patches,
)
from benchmarks.papers.polyfit.network import DgcnnRegressor, PointNetRegressor, Qstn
from benchmarks.papers.polyfit.train import (
    PolyFitConfig,
    fitted,
    load,
    network,
    prepare,
    raised,
    save,
    suite,
    train,
    train_missing,
)
from drape.errors import ArtifactError, InputError
from drape.geometry import jets
from drape.geometry.rotations import rotvec_to_matrix
from tests.training.training_setup import body, tube

TINY = PolyFitConfig(batch_size=16, point_count=32, patch_count=64, steps=8, warmup_steps=2)


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


def lively(seed: int = 0) -> Qstn:
    """A transformer whose head is not at its start."""
    torch.manual_seed(seed)
    model = Qstn().double().eval()
    last = list(model.head.children())[-1]
    assert isinstance(last, torch.nn.Linear)
    torch.nn.init.normal_(last.weight, std=0.3)
    return model


def cloud(rng: np.random.Generator, count: int = 80) -> np.ndarray:
    """An uneven patch, bowl-shaped enough to have a side."""
    uv = rng.uniform(-1.0, 1.0, size=(count, 2)) * [1.0, 0.7]
    return np.column_stack([uv, 0.3 * uv[:, 0] ** 2 + 0.2 * uv[:, 1] ** 2 + 0.1 * uv[:, 0] ** 3 - 0.1 * uv[:, 1]])


# --- the fit ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 6])
def test_fit_finds_an_exact_jet_again(rng, order):
    uv = torch.from_numpy(rng.uniform(-1, 1, size=(3, 120, 2)))
    wanted = torch.from_numpy(rng.normal(size=(3, jets.coefficient_count(order))))
    height = (jets.basis(uv, order) @ wanted[..., None])[..., 0]
    found = fit.fit_jet(torch.cat([uv, height[..., None]], dim=-1), order=order, ridge=1e-13)
    assert_allclose(found.coefficients, wanted, rtol=0, atol=1e-6)
    assert_allclose(found.residual, 0.0, rtol=0, atol=1e-8)
    assert float(fit.height_rmse(found).max()) < 1e-5


def test_fitted_normals_of_an_exact_jet_are_the_surface_normals():
    drawn = families.draw_patches(6, 90, families=("jet",), seed=(1, 2))
    found = fit.fit_jet(drawn.points.double(), order=4, ridge=1e-12)
    assert float(fit.normal_error_deg(found, drawn.normals.double()).max()) < 0.05


def test_turning_patch_and_frame_together_changes_no_error(rng):
    drawn = families.draw_patches(4, 64, families=families.FAMILIES, seed=(0, 0))
    rotation = torch.from_numpy(rotvec_to_matrix(rng.normal(size=3)))
    moved = families.Patches(3.0 * drawn.points.double() @ rotation.T + 1.0, drawn.normals.double() @ rotation.T)
    first = fitted(None, prepare(families.Patches(drawn.points.double(), drawn.normals.double())), order=4)
    second = fitted(None, prepare(moved), order=4)
    assert_allclose(fit.height_rmse(second[0]), fit.height_rmse(first[0]), rtol=1e-6, atol=1e-9)
    assert_allclose(fit.normal_error_deg(*second), fit.normal_error_deg(*first), rtol=1e-5, atol=1e-6)


def test_steepness_and_overhang_see_only_normals_that_lean_over():
    up = torch.tensor([[[0.0, 0.0, 1.0]] * 4, [[0.0, 0.0, -1.0]] * 4])
    assert_allclose(fit.steepness(up), 0.0, atol=0)
    assert_allclose(fit.over_share(up), 0.0, atol=0)
    one_over = torch.tensor([[[0.0, 0.0, 1.0]] * 3 + [[0.0, 0.0, -1.0]]])
    assert_allclose(fit.over_share(one_over), 0.25, atol=0)
    assert float(fit.steepness(one_over)) == pytest.approx(1.2**2 / 4)


# --- the families ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", families.FAMILIES)
def test_parameters_fill_the_stated_ranges(name):
    drawn = families.draw_parameters(name, 4000, np.random.default_rng(0))
    ranges = {"alpha": families.AMPLITUDE, "theta": families.THETA, "sigma": families.SIGMA, "centre": (-1.0, 1.0)}
    for key, values in drawn.items():
        low, high = ranges[key]
        assert low <= float(values.min()) < low + 0.01 * (high - low)
        assert high - 0.01 * (high - low) < float(values.max()) <= high
    assert families.AMPLITUDE == (-0.5, 0.5) and families.SIGMA == (0.5, 1.0) and families.BESSEL_K == 5.0
    assert (np.pi, 2 * np.pi) == families.THETA


@pytest.mark.parametrize("name", families.FAMILIES)
def test_gradients_of_the_families_are_those_of_finite_differences(name, rng):
    function = families._FUNCTIONS[name]
    drawn = families.draw_parameters(name, 3, np.random.default_rng(5))
    parameters = {key: value.double() for key, value in drawn.items()}
    uv = torch.from_numpy(rng.uniform(-1, 1, size=(3, 20, 2)))
    step = 1e-5  # torch's Bessel functions are good to about 1e-12
    for axis in range(2):
        shift = torch.zeros(2, dtype=torch.float64)
        shift[axis] = step
        difference = (function(uv + shift, parameters)[0] - function(uv - shift, parameters)[0]) / (2 * step)
        assert_allclose(function(uv, parameters)[1][..., axis], difference, rtol=0, atol=1e-6)


def test_a_patch_is_the_sum_of_its_families():
    seed = (3, 4)
    both = families.draw_patches(5, 20, families=("gaussian",), seed=seed).points
    assert float(both[..., :2].abs().max()) <= 1.0
    assert float(both[..., 2].abs().max()) <= 0.5  # one Gaussian is no higher than its amplitude
    again = families.draw_patches(5, 20, families=("gaussian",), seed=seed).points
    assert torch.equal(both, again)
    assert not torch.equal(both, families.draw_patches(5, 20, families=("gaussian",), seed=(3, 5)).points)


# --- the networks ----------------------------------------------------------------------------------------------------


def test_the_transformer_starts_as_the_identity():
    points = families.draw_patches(4, 30, families=families.FAMILIES, seed=(0, 1)).points
    assert_allclose(Qstn()(points).detach(), [[1.0, 0.0, 0.0, 0.0]] * 4, rtol=0, atol=1e-6)


@pytest.mark.parametrize("model", [lively(), PointNetRegressor(4).double(), DgcnnRegressor(4).double()], ids=type)
def test_the_order_of_points_does_not_matter(model, rng):
    points = torch.from_numpy(rng.normal(size=(3, 40, 3)))
    with torch.no_grad():
        assert_allclose(model(points[:, rng.permutation(40)]), model(points), rtol=0, atol=1e-12)


def test_a_repeated_point_changes_nothing(rng):
    points = torch.from_numpy(rng.normal(size=(2, 25, 3)))
    padded = torch.cat([points, points[:, -1:].expand(-1, 9, -1)], dim=1)
    with torch.no_grad():
        assert_allclose(lively()(padded), lively()(points), rtol=0, atol=1e-12)


def test_quaternions_are_of_unit_length(rng):
    with torch.no_grad():
        length = lively()(torch.from_numpy(rng.normal(size=(9, 12, 3)))).norm(dim=-1)
    assert_allclose(length, 1.0, rtol=0, atol=1e-12)


def test_edge_convolution_is_the_maximum_over_edges(rng):
    model = DgcnnRegressor(4).double()
    x = torch.from_numpy(rng.normal(size=(1, 20, 3)))
    a, b = model.neighbour[0], model.own[0]
    near = torch.cdist(x, x)[0].topk(8, largest=False).indices
    edges = torch.stack([torch.stack([model.activation(a(x[0, j]) + b(x[0, i])) for j in near[i]]) for i in range(20)])
    gathered = a(x)[0][near]
    assert_allclose(edges.amax(1).detach(), model.activation(gathered.amax(1) + b(x)[0]).detach(), atol=1e-12)


# --- frames ----------------------------------------------------------------------------------------------------------


def test_canonical_frame_is_a_proper_frame(rng):
    points = torch.from_numpy(np.stack([cloud(rng), cloud(rng) @ rotvec_to_matrix(rng.normal(size=3)).T]))
    own = canonical(points)
    assert_allclose(np.linalg.det(own.axes), 1.0, rtol=0, atol=1e-12)
    back = own.centre[:, None] + own.size[:, None, None] * own.local @ own.axes.mT
    assert_allclose(back, points, rtol=0, atol=1e-12)
    assert_allclose(np.linalg.norm(own.local, axis=-1).max(axis=1), 1.0, rtol=0, atol=1e-9)


# --- garments and training -------------------------------------------------------------------------------------------


def test_sampled_points_lie_on_their_own_cluster(rng):
    rest = tube()
    label = (np.arctan2(rest.vertices[:, 0], rest.vertices[:, 2]) > 0).astype(int)
    points, normals = sample_patches(rest, label, point_count=50, rng=rng)
    assert points.shape == normals.shape == (2, 50, 3)
    assert points[0][:, 0].max() < 0.03 and points[1][:, 0].min() > -0.03
    assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, rtol=0, atol=1e-5)
    assert (np.einsum("kna,kna->kn", normals[..., [0, 2]], points[..., [0, 2]]) > 0).all()


def test_a_training_gives_the_same_bits_again_and_from_its_file(tmp_path):
    first, second = (train(network(TINY), TINY) for _ in range(2))
    save(tmp_path / "one.pt", first, TINY)
    kept, config = load(tmp_path / "one.pt")
    assert config == TINY and not kept.training
    for name, value in first.state_dict().items():
        assert torch.equal(value, second.state_dict()[name]), name
        assert torch.equal(value, kept.state_dict()[name]), name


@pytest.mark.parametrize("kind", ["qstn", "pointnet", "dgcnn"])
def test_training_lowers_the_height_error(kind):
    config = replace(TINY, kind=kind, steps=60, learning_rate=3e-3)
    held = prepare(families.draw_patches(64, 48, families=families.FAMILIES, seed=(9, 9)))
    model, errors = network(config), []
    for _ in range(2):
        with torch.no_grad():
            errors.append(float(fit.height_rmse(fitted(model.eval(), held, order=4)[0]).mean()))
        model = train(model.train(), config)
    assert errors[1] < (0.999 if kind == "qstn" else 0.9) * errors[0]


def test_fine_tuning_starts_from_its_pretraining_and_what_is_done_is_not_trained_again(tmp_path, monkeypatch):
    patches = draw_garment_patches([NamedGarment("tube", tube())], partitions=1, point_count=40, seed=0)
    monkeypatch.setattr("benchmarks.papers.polyfit.train.garment_patches", lambda folder, config: patches)
    small = {"batch_size": 8, "point_count": 24, "steps": 2}
    configs = {name: replace(config, **small) for name, config in suite().items() if name in ("families", "finetuned")}
    models = train_missing(tmp_path, configs)
    written = {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("*.pt")}
    train_missing(tmp_path, configs)
    assert {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("*.pt")} == written
    assert set(written) == {"families.pt", "finetuned.pt"} and isinstance(models["finetuned"], Qstn)
    start = replace(configs["finetuned"], steps=0)
    (tmp_path / "finetuned.pt").unlink()
    same = train_missing(tmp_path, configs | {"finetuned": start})
    for name, value in same["finetuned"].state_dict().items():
        assert torch.equal(value, models["families"].state_dict()[name]), name


def test_raised_patches_have_the_normals_of_the_raised_surface():
    drawn = families.draw_patches(4, 200, families=("gaussian",), seed=(2, 2))
    patches = families.Patches(drawn.points.double(), drawn.normals.double())
    higher = raised(patches, torch.full((4,), 2.0))
    found = fit.fit_jet(higher.points, order=8, ridge=1e-12)
    assert float(fit.normal_error_deg(found, higher.normals).max()) < 0.5
    same = raised(patches, torch.ones(4))
    assert_allclose(same.points, prepare(patches).points, rtol=0, atol=1e-12)


def test_training_on_nothing_is_refused():
    with pytest.raises(InputError, match="families"):
        train(network(TINY), replace(TINY, families=()))


def test_a_run_that_is_never_finite_stops_with_a_sentence():
    model = network(TINY)
    torch.nn.init.constant_(next(model.parameters()), float("nan"))
    with pytest.raises(InputError, match="Lower learning_rate"):
        train(model, replace(TINY, steps=50))


def test_a_damaged_checkpoint_is_refused(tmp_path):
    (tmp_path / "bad.pt").write_bytes(b"no checkpoint")
    with pytest.raises(ArtifactError, match=r"bad\.pt"):
        load(tmp_path / "bad.pt")


@pytest.mark.data
@pytest.mark.slow
def test_held_out_garments_are_those_of_the_data_folder(data, tmp_path, monkeypatch):
    if not (data / "garments").is_dir():
        pytest.skip("DRAPE_DATA has no folder garments: docs/guide/data.md says what goes there.")
    own = tmp_path / "data" / "garments"
    own.mkdir(parents=True)
    files = sorted(path for path in (data / "garments").iterdir() if path.is_file())
    least = min(
        (path for path in files if path.suffix == ".obj" and "avatar" not in path.stem), key=lambda p: p.stat().st_size
    )
    for path in files:
        if path == least or path.stem.startswith("avatar"):
            shutil.copy(path, own)
    monkeypatch.setenv("DRAPE_DATA", str(tmp_path / "data"))
    garments, where = held_out_garments(body(), folder=tmp_path)
    assert [garment.name for garment in garments] == [least.stem] and where == "garments never trained on"
