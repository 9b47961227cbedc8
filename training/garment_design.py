"""Garments cut from MakeHuman's helper surfaces: one parametrised design space, seven points of which are trained on.

    python -m training.garment_design [NAME ...] [--out runs/cut_garments]

The product ships garments that are sewn (recovery.catalogue); these have names of sewn ones.
A design names where the surface is cut (hem, sleeve, neckline, armhole) and how far it
stands off the body (ease, flare).
Lengths in metres on the standard body at rest, y up; heights of a design count from the floor.
"""

from __future__ import annotations

import argparse
import hashlib
from dataclasses import asdict, dataclass, replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import scipy.sparse
import trimesh
from scipy.spatial import KDTree

from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.folders import RUNS
from drape.garment.cache import FORMAT_VERSION, Garment, save_garment
from drape.garment.files.mesh import plain_mesh
from drape.garment.fitting import fit_garment
from drape.garment.intake import INTAKE_VERSION
from drape.garment.skin import smoothing_matrix
from drape.geometry import meshes
from drape.geometry.closest import closest_point, signed_distance
from training.mesh_cut import cut_mesh

CUT_DIR = RUNS / "cut_garments"
HELPERS_FILE = Path(str(files("training"))) / "assets" / "helpers.npz"  # surfaces that garments are cut from
CLEARANCE_M = 0.0065  # intake promises 6 mm; half a millimetre covers rounding to float32
CLEFT_HALF_WIDTH_M, CLEFT_TOP_M, CLEFT_PASSES = 0.07, 1.04, 120
TAUBIN_SHARES = (0.5, -0.51)
SLIVER_SHARE = 0.003  # times the area of the mean triangle


@dataclass(frozen=True)
class GarmentCuts:
    """Where a garment is cut [m], heights from the floor, and its distance from the body; ``None`` leaves a cut out.

    ``hem_y`` lowest height of the torso; ``waist_y`` upper edge of trousers, and where the cloth of a
    dress or a skirt leaves the body; ``band_y`` upper edge of a skirt, ``skirt_hem_y`` lower edge of both;
    ``sleeve_x`` where the sleeve ends, seen from the middle; ``armhole`` share of arm weight
    at which a sleeveless garment is cut; ``leg_y`` lower edge of trouser legs; ``neck`` half
    axes (x, y, z) and ``neck_centre`` (y, z) of the ellipsoid that cuts the neckline;
    ``ease`` distance from the body [m], ``flare`` more of it per metre towards the open ends;
    ``skirt_flare`` metres outward per metre down; ``smoothing`` passes that bridge hollows.
    """

    name: str
    hem_y: float | None = None
    waist_y: float | None = None
    band_y: float | None = None
    sleeve_x: float | None = None
    armhole: float | None = None
    leg_y: float | None = None
    neck: tuple[float, float, float] | None = None
    neck_centre: tuple[float, float] = (1.60, 0.016)
    ease: float = 0.012
    flare: float = 0.04
    skirt_flare: float = 0.0
    skirt_hem_y: float | None = None
    smoothing: int = 30


CREW = (0.085, 0.115, 0.115)
SCOOP = (0.105, 0.19, 0.135)
SIX: tuple[GarmentCuts, ...] = (
    GarmentCuts("tshirt", hem_y=0.935, sleeve_x=0.40, neck=CREW, ease=0.018, flare=0.04, smoothing=50),
    GarmentCuts("longsleeve", hem_y=0.925, sleeve_x=0.69, neck=CREW, ease=0.014, flare=0.04, smoothing=40),
    GarmentCuts("tank", hem_y=0.95, armhole=0.5, neck=SCOOP, ease=0.012, flare=0.06, smoothing=40),
    GarmentCuts("trousers", waist_y=1.06, leg_y=0.12, ease=0.014, flare=0.03),
    GarmentCuts("shorts", waist_y=1.06, leg_y=0.56, ease=0.018, flare=0.08),
    GarmentCuts("dress", waist_y=1.10, armhole=0.5, neck=SCOOP, ease=0.010, skirt_flare=0.28, skirt_hem_y=0.48),
)
# Trained on beside the six.
EXTRA: tuple[GarmentCuts, ...] = (
    GarmentCuts("skirt", band_y=1.06, waist_y=0.95, ease=0.008, flare=0.0, skirt_flare=0.15, skirt_hem_y=0.50),
)
DESIGNS = {design.name: design for design in (*SIX, *EXTRA)}


def helper_surface(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns vertices [m] (N, 3), faces (F, 3) and skinning weights (N, 24) of the helper surface ``name``, "tights"
    or "skirt", on the standard body at rest, after one Loop subdivision."""
    with np.load(HELPERS_FILE, allow_pickle=False) as stored:
        vertices, faces, weights = (stored[f"{name}_{part}"] for part in ("vertices", "faces", "weights"))
    # Subdividing weights beside positions keeps both on one rule.
    both = np.concatenate([vertices, weights], axis=1).astype(np.float64)
    midpoint, fine = _loop(both, faces)
    return midpoint[:, :3], fine, np.clip(midpoint[:, 3:], 0.0, 1.0)


def _loop(values: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    columns = []
    fine = faces
    for start in range(0, values.shape[1], 3):
        block = values[:, start : start + 3]
        padded = np.pad(block, ((0, 0), (0, 3 - block.shape[1])))
        moved, fine = trimesh.remesh.subdivide_loop(padded, faces, iterations=1)
        columns.append(moved[:, : block.shape[1]])
    return np.concatenate(columns, axis=1), np.asarray(fine)


def build_design(design: GarmentCuts, body: BodyModel) -> tuple[np.ndarray, np.ndarray]:
    """Returns the vertices [m] (N, 3) and the faces (F, 3) of ``design`` on ``body`` at rest, at least 6 mm clear of
    it."""
    floor = np.array([0.0, body.v_template[:, 1].min(), 0.0])
    vertices, faces, weights = helper_surface("tights")
    vertices = vertices - floor
    index = {name: i for i, name in enumerate(JOINT_NAMES)}
    arm = sum(weights[:, index[f"{s}_{p}"]] for s in ("left", "right") for p in ("shoulder", "elbow", "wrist", "hand"))
    x, y, z = vertices.T
    fields = []
    if design.hem_y is not None:
        fields.append(y - design.hem_y + 10.0 * (arm > 0.5))
    if design.waist_y is not None:
        lower = design.skirt_hem_y is None
        fields.append((design.waist_y - y) if lower else (y - design.waist_y))
    if design.band_y is not None:
        fields.append(design.band_y - y - 10.0 * (arm > 0.5))
    if design.sleeve_x is not None:
        fields.append(design.sleeve_x - np.abs(x))
    if design.armhole is not None:
        fields.append(0.3 * (design.armhole - arm))
    if design.leg_y is not None:
        fields.append(y - design.leg_y)
    if design.neck is not None:
        cy, cz = design.neck_centre
        rx, ry, rz = design.neck
        fields.append(
            0.1 * (np.sqrt((x / rx) ** 2 + ((y - cy) / ry) ** 2 + ((z - cz) / rz) ** 2) - 1.0) - 10.0 * (y > cy + 0.06)
        )
    vertices, faces, weights = cut_mesh(vertices, faces, np.minimum.reduce(fields), weights)
    if design.skirt_hem_y is not None:
        vertices, faces = _attach_skirt(vertices, faces, design, floor)
    vertices = _stand_off(vertices, faces, design)
    return clear_of_body(vertices + floor, faces, body), faces


def _attach_skirt(
    vertices: np.ndarray, faces: np.ndarray, design: GarmentCuts, floor: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Joins the helper skirt below the bodice: rows of a regular grid from the bodice's lower edge to the hem."""
    skirt_vertices, skirt_faces, _ = helper_surface("skirt")
    rim = meshes.boundary_vertices(faces)
    assert design.waist_y is not None and design.skirt_hem_y is not None  # what makes a design a dress
    top, bottom = design.waist_y, design.skirt_hem_y
    waist = rim[np.abs(vertices[rim, 1] - top) < 0.02]
    centre = vertices[waist][:, [0, 2]].mean(axis=0)
    angle = np.arctan2(vertices[waist, 0] - centre[0], vertices[waist, 2] - centre[1])
    loop = waist[np.argsort(angle)]
    angle = np.sort(angle)
    spacing = 2 * np.pi * 0.16 / len(loop)
    rows = round((top - bottom) / (spacing * 0.9))
    profile = trimesh.Trimesh(skirt_vertices - floor, skirt_faces, process=False)
    points = [vertices[loop]]
    for row in range(1, rows + 1):
        height = top - row * (top - bottom) / rows
        ring = _ring(profile, height, centre, angle)
        down = top - height
        outward = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
        points.append(ring + design.skirt_flare * max(0.0, down - 0.12) * outward)
    grid = len(vertices) + np.arange(rows * len(loop)).reshape(rows, len(loop))
    grid = np.concatenate([loop[None], grid])
    upper, lower = grid[:-1], grid[1:]
    right_upper, right_lower = np.roll(upper, -1, axis=1), np.roll(lower, -1, axis=1)
    strip = np.concatenate(
        [
            np.stack([upper, lower, right_upper], -1).reshape(-1, 3),
            np.stack([right_upper, lower, right_lower], -1).reshape(-1, 3),
        ]
    )
    merged = np.concatenate([vertices, *points[1:]])
    normal = np.cross(merged[strip[0, 1]] - merged[strip[0, 0]], merged[strip[0, 2]] - merged[strip[0, 0]])
    outward = merged[strip[0, 0]] - np.array([centre[0], merged[strip[0, 0], 1], centre[1]])
    if normal @ outward < 0:
        strip = strip[:, ::-1]
    return merged, np.concatenate([faces, strip])


def _ring(profile: trimesh.Trimesh, height: float, centre: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Points [m] of the helper skirt at ``height`` in the directions ``angle`` from ``centre``."""
    low, high = profile.bounds[0, 1] + 0.01, profile.bounds[1, 1] - 0.02
    section = trimesh.intersections.mesh_plane(
        profile, plane_normal=[0, 1, 0], plane_origin=[0, np.clip(height, low, high), 0]
    )
    points = np.asarray(section).reshape(-1, 3)[:, [0, 2]] - centre
    at = np.arctan2(points[:, 0], points[:, 1])
    order = np.argsort(at)
    radius = np.interp(angle, at[order], np.linalg.norm(points[order], axis=1), period=2 * np.pi)
    return np.stack(
        [centre[0] + radius * np.sin(angle), np.full(len(angle), height), centre[1] + radius * np.cos(angle)], axis=1
    )


def _stand_off(vertices: np.ndarray, faces: np.ndarray, design: GarmentCuts) -> np.ndarray:
    """Vertices moved out by ease and flare, hollows bridged by smoothing; rims smoothed along themselves."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    normals = np.asarray(mesh.vertex_normals)
    smooth = smoothing_matrix(faces, len(vertices))
    for _ in range(8):
        normals = smooth @ normals
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rim = meshes.boundary_vertices(faces)
    # Only hems hang loose: a neckline, an armhole or a waistband keeps to the body.
    hems = rim[(vertices[rim, 1] < np.median(vertices[:, 1]) - 0.1) | (np.abs(vertices[rim, 0]) > 0.25)]
    reach, _ = KDTree(vertices[hems]).query(vertices)
    extra = design.flare * np.maximum(0.0, 0.30 - reach)
    moved = vertices + (design.ease + extra)[:, None] * normals
    return _bridge_cleft(_taubin(moved, faces, passes=design.smoothing), faces)


def _bridge_cleft(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Vertices with the cleft between the legs and the buttocks bridged, as cloth spans it.

    The helper surface follows the skin into the cleft; there plain smoothing, which shrinks hollows,
    is what is wanted.
    """
    rim = meshes.boundary_vertices(faces)
    x, y, _ = vertices.T
    share = np.exp(-((x / CLEFT_HALF_WIDTH_M) ** 2)) * np.clip((CLEFT_TOP_M - y) / 0.08, 0.0, 1.0)
    share[rim] = 0.0
    smooth = smoothing_matrix(faces, len(vertices))
    for _ in range(CLEFT_PASSES):
        vertices = vertices + share[:, None] * (smooth @ vertices - vertices)
    return vertices


def _taubin(vertices: np.ndarray, faces: np.ndarray, *, passes: int) -> np.ndarray:
    """Smoothed vertices without shrinkage (Taubin 1995); rims are smoothed along themselves only."""
    rim = meshes.boundary_vertices(faces)
    edges, uses = meshes.edge_uses(faces)
    on_rim = np.zeros(len(vertices), dtype=bool)
    on_rim[rim] = True
    # A rim vertex listens to the rim, an inner one to all its neighbours.
    listens = np.concatenate(
        [edges[~on_rim[edges[:, 0]]], edges[uses == 1], edges[~on_rim[edges[:, 1]]][:, ::-1], edges[uses == 1][:, ::-1]]
    )
    graph = scipy.sparse.csr_matrix((np.ones(len(listens)), (listens[:, 0], listens[:, 1])), shape=(len(vertices),) * 2)
    mean = scipy.sparse.diags(1.0 / np.asarray(graph.sum(axis=1)).ravel()) @ graph
    for _ in range(passes):
        for share in TAUBIN_SHARES:
            vertices = vertices + share * (mean @ vertices - vertices)
    return vertices


def clear_of_body(vertices: np.ndarray, faces: np.ndarray, body: BodyModel) -> np.ndarray:
    """Returns ``vertices`` [m] (N, 3) after they have been pushed to at least ``CLEARANCE_M`` from ``body`` at rest.
    The push is smoothed over the mesh, so that it leaves no spikes."""
    smooth = smoothing_matrix(faces, len(vertices))
    for _ in range(40):
        distance, outward = _outward(vertices, body)
        lack = np.maximum(0.0, CLEARANCE_M + 2e-4 - distance)
        if lack.max() < 2e-4:
            break
        push = lack[:, None] * outward
        spread = push
        for _ in range(3):
            spread = smooth @ spread
        vertices = vertices + np.where(lack[:, None] > 0, push, spread)
    return vertices


def _outward(points: np.ndarray, body: BodyModel) -> tuple[np.ndarray, np.ndarray]:
    distance = signed_distance(points, body.v_template, body.faces)
    away = (points - closest_point(points, body.v_template, body.faces).point) * np.sign(distance)[:, None]
    return distance, away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)


def vary_design(
    design: GarmentCuts, body: BodyModel, rng: np.random.Generator
) -> tuple[GarmentCuts, np.ndarray, np.ndarray]:
    """Returns a random neighbour of ``design`` with as many openings, and its vertices [m] (N, 3) and faces (F, 3).

    A draw that cuts a strap or a bridge away is thrown back: without it the garment would have nothing to hang from. So
    is one with a sliver of a triangle, whose strain would rule the energy.
    """
    wanted = trimesh.Trimesh(*build_design(design, body), process=False).euler_number
    while True:
        candidate = vary(design, rng)
        vertices, faces = build_design(candidate, body)
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        if mesh.euler_number == wanted and mesh.area_faces.min() > SLIVER_SHARE * mesh.area_faces.mean():
            return candidate, vertices, faces


def vary(design: GarmentCuts, rng: np.random.Generator) -> GarmentCuts:
    """Returns a random neighbour of ``design``, with other hems, sleeves, neckline, ease and flare within wearable
    ranges."""

    def jitter(value: float | None, spread: float) -> float | None:
        return None if value is None else value + float(rng.uniform(-spread, spread))

    neck = None if design.neck is None else tuple(float(a * rng.uniform(0.9, 1.2)) for a in design.neck)
    sleeve = None if design.sleeve_x is None else float(rng.uniform(0.28, 0.70))
    leg = None if design.leg_y is None else float(rng.uniform(0.10, 0.75))
    hem = None if design.hem_y is None else float(rng.uniform(0.92, 1.14))
    skirt_hem = None if design.skirt_hem_y is None else float(rng.uniform(0.40, 0.72))
    # What comes from other programs lies closer to the skin than what is drawn from here: half of all are tight.
    ease = rng.uniform(-0.004, 0.008) if rng.random() < 0.5 else rng.uniform(0.008, 0.022)
    return replace(
        design,
        hem_y=hem,
        sleeve_x=sleeve,
        leg_y=leg,
        neck=neck,
        skirt_hem_y=skirt_hem,
        waist_y=jitter(design.waist_y, 0.03),
        band_y=jitter(design.band_y, 0.03),
        ease=float(ease),
        flare=float(rng.uniform(0.0, 0.10)),
        skirt_flare=design.skirt_flare * float(rng.uniform(0.4, 1.6)),
        armhole=jitter(design.armhole, 0.08),
    )


def cut_garment(design: GarmentCuts, body: BodyModel) -> Garment:
    """Returns ``design`` on ``body`` as a garment with fitted patches, without texture coordinates and without a rest
    state of its own."""
    vertices, faces = build_design(design, body)
    key = vertices.tobytes() + faces.tobytes() + body.digest.encode() + f"{FORMAT_VERSION}.{INTAKE_VERSION}".encode()
    mesh = replace(plain_mesh(design.name, vertices, faces), material_names=("cloth",))
    manifest = {"source": "cut from MakeHuman's helper surfaces (CC0)", "design": asdict(design)}
    return fit_garment(mesh, vertices, faces, body, digest=hashlib.sha256(key).hexdigest(), manifest=manifest)


def main(arguments: list[str] | None = None) -> None:
    """Runs the command line: builds the named designs, or six where none is named, and writes each into ``--out`` in
    place of its older files."""
    parser = argparse.ArgumentParser(description="Builds garments cut from the body's surface and writes their caches.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(DESIGNS)}; the first six without")
    parser.add_argument("--out", type=Path, default=CUT_DIR)
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.names) - set(DESIGNS))
    if unknown:
        parser.error(f"expected of {', '.join(DESIGNS)}, got {', '.join(unknown)}")
    body = load_body()
    for design in [DESIGNS[name] for name in options.names] or SIX:
        garment = cut_garment(design, body)
        for old in options.out.glob(f"{design.name}-*.npz"):
            old.unlink()
        path = save_garment(garment, options.out)
        fit = garment.manifest["fit"]
        print(
            f"{design.name:11s} {garment.vertex_count:6d} vertices {garment.patch_count:4d} patches  "
            f"{1e3 * fit['point_rmse_m']:.2f} mm  {fit['normal_error_deg']:.2f} deg  {path.stat().st_size / 1e6:.2f} MB"
        )


if __name__ == "__main__":
    main()
