"""How a garment is sewn, as JSON beside its mesh: what its maker knows and a mesh file cannot say.

``NAME.json`` beside ``NAME.obj`` names lines by rows of the OBJ's v and vt, counted from 0: which are seams and how far
they are folded at rest, which are edges that are turned up or bound. It also names the fabric. The uv of such a mesh
are its panels, with the grain along +v. The dataclass ``Sewing`` writes and reads the file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from drape.errors import InputError
from drape.garment.files.mesh import GarmentMesh
from drape.garment.grain import CornerUv
from drape.geometry import meshes

FORMAT = "drape sewn garment"
FORMAT_VERSION = 1
DOUBLED_KINDS = ("hem", "opening")  # turned up, or bound: two layers that slide on each other


@dataclass(frozen=True)
class Seam:
    """A seam between two ``panels``, folded by ``angle_rad`` at rest, negative where it folds to the outside.
    ``vertices``: rows of the OBJ's v along it, from 0, in order; ``uv``: for either side the rows of vt."""

    name: str
    panels: Sequence[str]
    angle_rad: float
    vertices: Sequence[int]
    uv: Sequence[Sequence[int]]


@dataclass(frozen=True)
class FreeEdge:
    """An edge of ``panel`` that is not sewn to another; ``kind``: "hem" (turned up), "opening" (bound) or "free".
    ``vertices`` and ``uv``: rows of the OBJ's v and vt along it, from 0, in order."""

    name: str
    kind: str
    panel: str
    vertices: Sequence[int]
    uv: Sequence[int]


@dataclass(frozen=True)
class Sewing:
    """How a garment is sewn: the contents of ``NAME.json`` beside its OBJ file ``mesh``. ``uv_unit_m``: metres of cloth
    per unit of uv. Cloth nearer than ``hem_width_m`` to an edge that is turned up or bound bends ``hem_bending`` times
    as hard. ``panels``: their names. ``size`` and ``body`` name what it was cut for; ``ease_m`` [m] is what was added
    to girths of the body, by part ("chest", "arm", ...). ``figures``: numbers of its making, by any names."""

    name: str
    fabric: str
    mesh: str
    uv_unit_m: float
    hem_bending: float
    hem_width_m: float
    panels: Sequence[str]
    seams: Sequence[Seam]
    edges: Sequence[FreeEdge]
    size: str = ""
    body: str = ""
    ease_m: Mapping[str, float] = field(default_factory=dict)
    figures: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Returns the fields as a dictionary for JSON, with the format's name and version."""
        return {"format": FORMAT, "version": FORMAT_VERSION, **asdict(self)}

    def check(self, mesh: GarmentMesh) -> None:
        """Raises ``InputError`` where a row of v or vt of a seam or an edge is not in ``mesh``."""
        for what, rows, count in (
            ("vertices", [line.vertices for line in (*self.seams, *self.edges)], len(mesh.vertices)),
            ("uv", [side for seam in self.seams for side in seam.uv], len(mesh.uv)),
            ("uv", [edge.uv for edge in self.edges], len(mesh.uv)),
        ):
            named = [row for line in rows for row in line]
            if named and not 0 <= min(named) <= max(named) < count:
                raise InputError(
                    f"sewing {self.name} {what}",
                    expected=f"rows of the mesh, below {count}",
                    got=str(max(named) if max(named) >= count else min(named)),
                    cure="Put the JSON beside the mesh that it was written with.",
                )


def sewing_beside(path: Path) -> Sewing | None:
    """Returns the sewing in the JSON file of the same name beside the mesh at ``path``. None where there is no JSON of
    this format, or where it is about a mesh file of another format than ``path``. Raises ``InputError`` for one of
    another version, or with missing or unknown fields."""
    file = path.with_suffix(".json")
    if not file.is_file():
        return None
    try:
        record = json.loads(file.read_text())
    except (OSError, ValueError):
        return None  # some other program's
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        return None
    if record.get("version") != FORMAT_VERSION:
        raise InputError(
            f"sewing {file.name} version",
            expected=str(FORMAT_VERSION),
            got=str(record.get("version")),
            cure="Write the garment again with this release.",
        )
    found = read_sewing({key: value for key, value in record.items() if key not in ("format", "version")})
    return found if Path(found.mesh).suffix == path.suffix else None


def read_sewing(record: Mapping[str, Any]) -> Sewing:
    """Returns the sewing in ``record``, a dictionary as ``Sewing.to_json`` makes it, without format and version; raises
    ``InputError`` where fields are missing or unknown."""
    try:
        seams, edges = ([Seam(**one) for one in record["seams"]], [FreeEdge(**one) for one in record["edges"]])
        return Sewing(**{**record, "seams": seams, "edges": edges})
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"sewing {record.get('name', '')}",
            expected="the fields of docs/guide/catalogue.md",
            got=str(error),
            cure="Write the garment again with python -m recovery.catalogue build.",
        ) from error


# --- angles and hems for a rest state --------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SewnHinges:
    """Of H hinges, in the order of ``meshes.hinges``: the dihedral ``angle`` at rest [rad] (H,), and the ``stiffening``
    (H,), the factor of the fabric's bending."""

    angle: np.ndarray
    stiffening: np.ndarray


def sewn_hinges(
    sewing: Sewing, mesh: GarmentMesh, kept: np.ndarray, faces: np.ndarray, on_corners: CornerUv
) -> SewnHinges:
    """Returns the angles and the stiffening of the hinges of ``faces`` (G, 3), a subdivision of the faces of ``mesh``,
    as ``sewing`` says them.

    ``kept`` (V,): the row in ``mesh`` of every delivered vertex. In ``faces`` the delivered vertices come first, then
    those that subdivision added. ``on_corners``: the texture coordinates of ``faces``. A hinge has a seam's angle where
    both ends lie on the seam, else 0. Its stiffening is ``hem_bending`` where both ends are near an edge that is turned
    up or bound, on all panels that meet there, else 1.
    """
    ends = meshes.hinges(faces)[:, :2]
    angle = np.zeros(len(ends))
    folded = [seam for seam in sewing.seams if seam.angle_rad]
    on_seam = np.zeros((len(mesh.vertices), len(folded)))
    for column, seam in enumerate(folded):
        on_seam[kept[list(seam.vertices)], column] = 1.0
    coarse = mesh.faces
    while len(coarse) < len(faces):  # a new vertex lies on a seam if both ends of its edge do
        on_seam, coarse, _ = meshes.subdivide(on_seam, coarse)
    on_seam = on_seam[np.concatenate([kept, np.arange(len(mesh.vertices), len(on_seam))])]
    for column, seam in enumerate(folded):
        angle[(on_seam[ends, column] == 1.0).all(axis=1)] = seam.angle_rad
    rounds = len(faces) // len(mesh.faces)
    island_of_uv = np.zeros(len(mesh.uv), dtype=np.int64)
    island_of_uv[mesh.uv_faces] = on_corners.island[::rounds, None]
    panels = sewing.uv_unit_m * mesh.uv
    lines = [list(edge.uv) for edge in sewing.edges if edge.kind in DOUBLED_KINDS]
    turned = near_lines(
        sewing.uv_unit_m * on_corners.corners.reshape(-1, 2),
        np.repeat(on_corners.island, 3),
        [(int(island_of_uv[line[0]]), panels[line]) for line in lines],
        sewing.hem_width_m,
    )
    free = np.zeros(len(on_seam), dtype=bool)
    free[faces.reshape(-1)[~turned]] = True
    return SewnHinges(angle, np.where(free[ends].any(axis=1), 1.0, sewing.hem_bending))


def near_lines(
    points: np.ndarray, panel: np.ndarray, lines: Sequence[tuple[int, np.ndarray]], within_m: float
) -> np.ndarray:
    """Returns which ``points`` [m] (N, 2) lie within ``within_m`` of a line on their own panel, bool (N,). ``panel``
    (N,): the number of each point's panel. ``lines``: the number of a panel, and the polyline [m] (M, 2) on it."""
    near = np.zeros(len(points), dtype=bool)
    for number, line in lines:
        mine = np.flatnonzero(panel == number)
        near[mine[line_distance(points[mine], line) < within_m]] = True
    return near


def line_distance(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Returns the distances [m] (N,) of ``points`` (N, 2) to the polyline ``line`` [m] (M, 2)."""
    nearest = np.full(len(points), np.inf)
    for a, b in pairwise(line):
        along = b - a
        share = np.clip((points - a) @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(points - a - share[:, None] * along, axis=1))
    return nearest
