"""Raw scans of garments that we drape ourselves, each on a body and in a pose that a recovery is not told.

To the drape comes what a scanner leaves: noise, holes, bites in the borders, a hem that is folded in and lies double,
about a million triangles, and a file in centimetres, z up, off the origin. The same seed gives the same file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from benchmarks.harness import ROOT
from benchmarks.recovery.collar import used, with_collar
from drape.body.assets import load_body
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES
from drape.files.atomic import write_whole
from drape.geometry import meshes
from recovery.drape.pipeline import DrapeOptions, drape_pattern
from recovery.fit.contours import open_contours
from recovery.pattern.bases import base_pattern
from recovery.pattern.measurements import measure
from recovery.run.wearer import shaped_body

FOLDER = ROOT / "runs" / "raw_scans"  # ignored by git
EDGE_M = 0.022  # of the drape
TRIANGLES = 500_000  # at least; four times as many at most
NOISE_M, NOISE_WIDTH_M, ROUGH_M, WAVES = 0.002, 0.006, 0.0004, 400
HEM_M, HEM_GAP_M = 0.02, 0.002  # how wide a hem lies double, and how far inside
HOLES_SHARE, HOLE_M = 0.05, (0.012, 0.03)  # of the area; radii
BITES, BITTEN_M = 8, 0.5  # for each border longer than this
OFFSET_CM = (12.0, 30.0, 5.0)


@dataclass(frozen=True)
class Subject:
    """The garment of a scan, drafted from ``base`` with ``settings``, and its wearer: ``betas``, arms at ``arms_deg``.

    These are degrees below the T-pose's.
    """

    base: str
    settings: tuple[str, ...]
    betas: tuple[float, ...]
    arms_deg: float
    collar: bool = False


SUBJECTS = {
    "raw_polo": Subject("tshirt", ("length_m=0.70", "sleeve_length_m=0.24"), (1.2, -0.8, 0.5), 45.0, collar=True),
    "raw_dress": Subject("sleeved_dress", ("length_m=1.0", "gather=0.0"), (-1.2, 1.0, 0.8, -0.5), 40.0),
    "raw_tshirt": Subject("tshirt", ("length_m=0.72", "sleeve_length_m=0.22"), (0.0,), 45.0),
}


def raw_scan(name: str, folder: Path = FOLDER) -> Path:
    """The file of the scan called ``name``; it is made, in about a minute, where it is not there."""
    path = folder / f"{name}.ply"
    if path.exists():
        return path
    vertices, faces = draped(SUBJECTS[name])
    return write_whole(path, ply_bytes(*scanned(vertices, faces, seed=list(SUBJECTS).index(name))))


def draped(subject: Subject) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [m] (V, 3) and faces (F, 3) of the garment at rest on its wearer."""
    body = shaped_body(load_body(), np.array(subject.betas))
    pose, angle = np.zeros((JOINT_COUNT, 3)), np.deg2rad(subject.arms_deg)
    pose[[JOINT_NAMES.index("left_shoulder"), JOINT_NAMES.index("right_shoulder")], 2] = -angle, angle
    pattern = base_pattern(subject.base, measure(body), subject.settings)
    found = drape_pattern(pattern, body, DrapeOptions(edge_length_m=EDGE_M, grid_m=0.02), pose=pose)
    vertices, faces = found.nodes, found.mesh.faces
    if not subject.collar:
        return vertices, faces
    return with_collar(*finer(vertices, faces, 100_000))


def scanned(
    vertices: np.ndarray, faces: np.ndarray, *, seed: int, triangles: int = TRIANGLES
) -> tuple[np.ndarray, np.ndarray]:
    """What a scanner leaves of a garment of ``vertices`` [m] (V, 3) and ``faces`` (F, 3), in at least so many
    ``triangles`` but for its holes."""
    draw = np.random.default_rng(seed)
    vertices, faces = finer(vertices, faces, triangles // 8)
    vertices = vertices + NOISE_M * waves(vertices, draw)[:, None] * meshes.vertex_normals(vertices, faces)
    vertices, faces = with_double_hem(*finer(vertices, faces, triangles))
    vertices = vertices + ROUGH_M * draw.normal(size=vertices.shape)
    return used(vertices, with_bites(vertices, with_holes(vertices, faces, draw), draw))


def finer(vertices: np.ndarray, faces: np.ndarray, triangles: int) -> tuple[np.ndarray, np.ndarray]:
    """The mesh subdivided until it has so many ``triangles``."""
    while len(faces) < triangles:
        vertices, faces, _ = meshes.subdivide(vertices, faces)
    return vertices, faces


def waves(points: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """A smooth random number (n,) at each of ``points`` [m] (n, 3), of variance 1: waves of random ways and phases."""
    ways, phases = draw.normal(size=(WAVES, 3)) / NOISE_WIDTH_M, draw.uniform(0.0, 2.0 * np.pi, WAVES)
    return np.sqrt(2.0 / WAVES) * sum(np.cos(points @ way + phase) for way, phase in zip(ways, phases, strict=True))


def with_double_hem(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mesh with its lowest border folded in and sewn down: the strip along it stands there twice."""
    hem = min(open_contours(vertices, faces), key=lambda one: float(one.centre[1]))
    near = KDTree(hem.points).query(vertices)[0] < HEM_M
    strip = faces[near[faces].all(axis=1)]
    inner = np.setdiff1d(strip, meshes.boundary_vertices(strip))
    copies = np.arange(len(vertices))
    copies[inner] = len(vertices) + np.arange(len(inner))
    inside = vertices[inner] - HEM_GAP_M * meshes.vertex_normals(vertices, faces)[inner]
    return np.concatenate([vertices, inside]), np.concatenate([faces, copies[strip][:, ::-1]])


def with_holes(vertices: np.ndarray, faces: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """``faces`` without round patches, until ``HOLES_SHARE`` of the area is gone."""
    middle, area = vertices[faces].mean(axis=1), meshes.face_areas(vertices, faces)
    gone = np.zeros(len(faces), dtype=bool)
    while area[gone].sum() < HOLES_SHARE * area.sum():
        gone |= np.linalg.norm(middle - middle[draw.integers(len(faces))], axis=1) < draw.uniform(*HOLE_M)
    return faces[~gone]


def with_bites(vertices: np.ndarray, faces: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """``faces`` without ``BITES`` round patches at every long border."""
    for border in open_contours(vertices, faces):
        for _ in range(BITES if border.length_m > BITTEN_M else 0):
            place = border.points[draw.integers(len(border.points))]
            faces = faces[np.linalg.norm(vertices[faces].mean(axis=1) - place, axis=1) > draw.uniform(*HOLE_M)]
    return faces


def ply_bytes(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """A binary PLY of ``vertices`` [m] (V, 3), y up, and ``faces`` (F, 3): in centimetres, z up, off the origin."""
    placed = 100.0 * np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1) + OFFSET_CM
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(placed)}\n{axes}element face {len(faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    rows = np.zeros(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    return head.encode() + placed.astype("<f4").tobytes() + rows.tobytes()
