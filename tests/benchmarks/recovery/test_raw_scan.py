"""Raw scans: what is taken from the cloth and added to it, their unit and axes, and one file for one seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.recovery import raw_scan
from benchmarks.recovery.collar import with_collar
from drape.garment.files.mesh import read_mesh
from drape.geometry import meshes
from recovery.fit.contours import open_contours

RADIUS_M, HEIGHT_M = 0.15, 0.6


def tube(around: int = 40, along: int = 26) -> tuple[np.ndarray, np.ndarray]:
    """An open tube round the y axis, normals outward."""
    angle, height = np.meshgrid(2.0 * np.pi * np.arange(around) / around, np.linspace(0.0, HEIGHT_M, along))
    points = np.stack([RADIUS_M * np.sin(angle), height, RADIUS_M * np.cos(angle)], axis=-1).reshape(-1, 3)
    first = np.arange(around * (along - 1)).reshape(along - 1, around)
    beside, above = np.roll(first, -1, axis=1), first + around
    over = np.roll(above, -1, axis=1)
    pairs = [(first, beside, over), (first, over, above)]
    return points, np.concatenate([np.stack(corners, axis=-1).reshape(-1, 3) for corners in pairs])


def test_holes_take_a_twentieth_of_the_area_and_hardly_more():
    vertices, faces = raw_scan.finer(*tube(), 8000)
    left = raw_scan.with_holes(vertices, faces, np.random.default_rng(1))
    area = meshes.face_areas(vertices, faces).sum()
    gone = 1.0 - meshes.face_areas(vertices, left).sum() / area
    assert raw_scan.HOLES_SHARE <= gone < raw_scan.HOLES_SHARE + np.pi * 0.04**2 / area
    assert len(open_contours(vertices, left)) > 2 + 0.5 * raw_scan.HOLES_SHARE * area / (np.pi * 0.03**2)


def test_bites_lie_at_the_long_borders():
    vertices, faces = raw_scan.finer(*tube(), 8000)
    left = raw_scan.with_bites(vertices, faces, np.random.default_rng(1))
    bitten = vertices[faces].mean(axis=1)[~(faces[:, None] == left[None]).all(axis=2).any(axis=1), 1]
    assert len(bitten) and (np.minimum(bitten, HEIGHT_M - bitten) < raw_scan.HOLE_M[1]).all()
    assert len(open_contours(vertices, left)) == 2


def test_a_double_hem_is_sewn_to_the_lowest_border_and_lies_inside():
    vertices, faces = raw_scan.with_double_hem(*raw_scan.finer(*tube(), 20_000))
    edges, uses = meshes.edge_uses(faces)
    sewn = vertices[edges[uses == 3]]
    assert 0.0 < sewn[..., 1].max() <= raw_scan.HEM_M
    assert np.hypot(vertices[:, 0], vertices[:, 2]).min() == pytest.approx(RADIUS_M - raw_scan.HEM_GAP_M, abs=1e-3)


def test_noise_has_the_variance_of_one_and_is_smooth():
    points = np.random.default_rng(1).uniform(0.0, 0.5, (4000, 3))
    near = np.concatenate([points, points + np.array([1e-4, 0.0, 0.0])])
    first, second = raw_scan.waves(near, np.random.default_rng(2)).reshape(2, -1)
    assert first.std() == pytest.approx(1.0, abs=0.1) and np.abs(second - first).max() < 0.1


def test_a_scan_is_in_centimetres_with_z_up_and_the_same_for_the_same_seed(tmp_path: Path):
    payloads = [raw_scan.ply_bytes(*raw_scan.scanned(*tube(), seed=seed, triangles=8000)) for seed in (1, 1, 2)]
    assert payloads[0] == payloads[1] != payloads[2]
    (tmp_path / "tube.ply").write_bytes(payloads[0])
    mesh = read_mesh(tmp_path / "tube.ply")
    size, middle = np.ptp(mesh.vertices, axis=0), mesh.vertices.mean(axis=0)
    assert size == pytest.approx(100.0 * np.array([2 * RADIUS_M, 2 * RADIUS_M, HEIGHT_M]), abs=2.0)
    assert middle == pytest.approx(np.add(raw_scan.OFFSET_CM, [0.0, 0.0, 50.0 * HEIGHT_M]), abs=2.0)
    assert len(np.unique(mesh.faces)) == len(mesh.vertices) and len(mesh.faces) > 7000


def test_a_scan_that_is_there_is_not_made_again(tmp_path: Path):
    (tmp_path / "raw_polo.ply").write_bytes(b"ply")
    assert raw_scan.raw_scan("raw_polo", tmp_path).read_bytes() == b"ply"


def test_a_collar_goes_on_from_the_neckline_with_its_outside_out_and_leaves_a_slit():
    vertices, faces = with_collar(*raw_scan.finer(*tube(), 20_000))
    _, uses = meshes.edge_uses(faces)
    turned = meshes.half_edges(faces)[:, :2]
    assert uses.max() == 2 and len(np.unique(turned, axis=0)) == len(turned)  # neighbours are oriented alike
    border = max(open_contours(vertices, faces), key=lambda one: one.centre[1])
    assert vertices[:, 1].max() > HEIGHT_M + 0.03 and border.points[:, 1].min() < HEIGHT_M - 0.1
    assert len(open_contours(vertices, faces)) == 2
