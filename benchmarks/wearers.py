"""Who wore a garment, found with nothing said, where it is known: garments carried on other bodies, poses and files.

    python -m benchmarks.wearers
    python -m benchmarks.wearers --cases 20 --garments tshirt skirt

A case is a garment of the catalogue on one of twelve bodies, in T-, A- or relaxed pose, in one of five units and three
up axes, its origin at the pelvis, on the floor or anywhere within a metre. ``origin_mm`` is how far the middle of the
skin is from where it should be under the uppermost 15 cm of cloth, which carry the garment; ``along_mm`` the same under
all of it, to which legs of another length in loose trousers count; ``shape_mm`` the mean distance between both skins
there, and ``arms_deg`` the error of arms in sleeves.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from benchmarks.harness import Benchmark, Option, Run
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.catalog import find_garments, open_garment
from drape.errors import MeshError
from drape.garment.cache import Garment
from drape.garment.files.mesh import GarmentMesh, read_mesh
from drape.garment.mesh_checks import UNITS_M
from drape.garment.registration import posed_by, unpack_parameters
from drape.garment.skin import bind_to_body
from drape.garment.wearer_fields import known_parameters
from drape.garment.wearer_reading import Reading, WearerCandidate
from drape.garment.wearer_search import the_wearer
from drape.geometry.closest import closest_point, nearest_vertices
from drape.geometry.skinning import skin_points

BODY_COUNT, SHAPE_SPREAD, HEIGHT_SPREAD = 12, 0.4, 0.5
POSES = {"T": (0.0, 0.0), "A": (0.7, 0.0), "relaxed": (1.15, 0.2)}
AXES = {"+y": "+z", "+z": "-y", "+x": "+y"}
ARMS = [JOINT_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("shoulder", "elbow", "wrist")]
SLEEVED = 0.1  # of the weights on the arms
COVERED_M, CARRYING_M, ORIGIN_MM = 0.04, 0.15, 20.0
COLUMNS = {
    "garment": "s", "pose": "s", "unit": "s", "up": "s", "unit_right": "d", "axis_right": "d", "origin_mm": ".0f",
    "along_mm": ".0f", "arms_deg": ".1f", "shape_mm": ".0f", "sure": ".2f", "seconds": ".1f",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class WornCase:
    """A garment's file, as text would hold it, and the truth: reading, shift of the origin [m], skin [m] (V, 3)."""

    mesh: GarmentMesh
    reading: Reading
    pose: str
    shift: np.ndarray
    skin: np.ndarray
    arms_deg: float
    sleeved: bool

    def in_metres(self, points: np.ndarray) -> np.ndarray:
        """Returns ``points`` (N, 3) of the file in the frame of ``skin``."""
        return self.reading.apply(points) - self.shift


def draw_bodies(body: BodyModel) -> np.ndarray:
    """Shapes (12, S), drawn round the known women, men and people."""
    draw = np.random.default_rng(3)
    found = []
    for number in range(BODY_COUNT):
        shape = unpack_parameters(body, known_parameters(body, ("woman", "man", "person")[number % 3], 0.0, 0.0))[0]
        spread = np.array([HEIGHT_SPREAD, *[SHAPE_SPREAD] * (body.shape_count - 1)])
        found.append(shape + spread * draw.standard_normal(body.shape_count) - 0.4 * np.eye(body.shape_count)[0])
    return np.array(found)


def carry_garment(
    garment: Garment, body: BodyModel, betas: np.ndarray, pose: str, draw: np.random.Generator
) -> WornCase:
    """Returns ``garment`` on the body of shape ``betas`` in ``pose``, in a file of a unit, axis and origin that are
    drawn.
    """
    parameters = known_parameters(body, "standard", *POSES[pose])
    parameters[: body.shape_count] = betas
    angles = unpack_parameters(body, parameters)[1]
    rest = np.asarray(garment.vertices[: garment.vertex_count], dtype=np.float64)
    binding = bind_to_body(rest, garment.faces.astype(np.int64), body)
    rotations, translations = body.bones(angles[None], None, betas)
    worn = skin_points((rest + binding.shapedirs @ betas)[None], binding.weights, rotations, translations)[0]
    unit, up = draw.choice(list(UNITS_M)), draw.choice(list(AXES))
    reading = Reading(str(unit), UNITS_M[unit], str(up), AXES[up])
    skin = posed_by(body, parameters)
    shifts = (np.zeros(3), np.array([0.0, -skin[:, 1].min(), 0.0]), draw.uniform(-1.0, 1.0, 3))
    shift = shifts[draw.integers(3)]
    lines = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in (worn + shift) @ reading.turn / reading.scale]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in garment.faces.tolist()]
    truth = WearerCandidate(reading, body, parameters, 0.0, 0.0, 0.0, 0.0, sleeved=True)
    sleeved = float(binding.weights[:, ARMS].sum(axis=1).mean()) > SLEEVED
    mesh = read_mesh("\n".join(lines).encode(), name=garment.name, kind="obj")
    return WornCase(mesh, reading, pose, shift, skin, truth.arms_deg, sleeved)


def judge_case(case: WornCase, body: BodyModel) -> dict[str, object]:
    """Returns the row of ``case``: the wearer that is found, beside the truth."""
    begun_s = time.process_time()
    row: dict[str, object] = {"pose": case.pose, "unit": case.reading.unit, "up": case.reading.up}
    try:
        found = the_wearer(case.mesh, body)
    except MeshError:
        return row | {"unit_right": 0, "axis_right": 0, "seconds": time.process_time() - begun_s}
    row |= {"seconds": time.process_time() - begun_s, "sure": found.sure}
    row["unit_right"] = int(found.reading.unit == case.reading.unit)
    row["axis_right"] = int((found.reading.up, found.reading.front) == (case.reading.up, case.reading.front))
    there = found.reading
    skin = case.in_metres(posed_by(body, found.parameters) @ there.turn / there.scale)
    cloth = case.in_metres(case.mesh.vertices)
    covered = nearest_vertices(case.skin, cloth)[0] < COVERED_M
    carrying = covered & (case.skin[:, 1] > cloth[:, 1].max() - CARRYING_M)
    for key, rows in (("origin_mm", carrying), ("along_mm", covered)):
        row[key] = 1e3 * float(np.linalg.norm((skin - case.skin)[rows].mean(axis=0)))
    row["shape_mm"] = 1e3 * float(closest_point(case.skin[covered], skin, body.faces).distance.mean())
    if case.sleeved:
        row["arms_deg"] = abs(found.arms_deg - case.arms_deg)
    return row


@Benchmark(
    "wearers",
    "Who wore a garment, found with nothing said.",
    COLUMNS,
    Option("--cases", 100, "garments drawn", 4),
    Option("--garments", (), "of the catalogue (all)", kind=str),
)
def main(run: Run) -> None:
    """Adds to ``run`` a row for every case, the shares that are right, and the means."""
    body, draw = load_body(), np.random.default_rng(7)
    shapes = draw_bodies(body)
    garments = [open_garment(name, body) for name in find_garments(run.options.garments)]
    rows = []
    for _ in range(run.options.cases):
        garment = garments[draw.integers(len(garments))]
        pose = list(POSES)[draw.integers(len(POSES))]
        case = carry_garment(garment, body, shapes[draw.integers(BODY_COUNT)], pose, draw)
        rows.append({"garment": garment.name, **judge_case(case, body)})
        run.add(rows[-1:])
    run.extra |= wearer_summary(rows)


def wearer_summary(rows: list[dict[str, object]]) -> dict[str, float]:
    """Shares [%] of cases with the right unit, axes and origin, means of the errors, and seconds."""

    def values(key: str) -> np.ndarray:
        return np.array([row[key] for row in rows if key in row], dtype=np.float64)

    right = np.array([float(row.get("origin_mm", np.inf)) <= ORIGIN_MM for row in rows])  # type: ignore[arg-type]
    found = {
        "unit_right_pct": 100.0 * values("unit_right").mean(),
        "axis_right_pct": 100.0 * values("axis_right").mean(),
        "origin_right_pct": 100.0 * right.mean(),
        "origin_median_mm": np.median(values("origin_mm")) if len(values("origin_mm")) else np.nan,
        "along_right_pct": 100.0 * (values("along_mm") <= ORIGIN_MM).sum() / len(rows),
        "shape_mean_mm": values("shape_mm").mean() if len(values("shape_mm")) else np.nan,
        "arms_mean_deg": values("arms_deg").mean() if len(values("arms_deg")) else np.nan,
        "seconds_mean": values("seconds").mean(),
    }
    return {key: round(float(value), 2) for key, value in found.items()}


if __name__ == "__main__":
    main.command()
