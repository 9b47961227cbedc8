"""Says where on a garment a point is, in words that its maker knows: near which joint, how far from which opening."""

from __future__ import annotations

import numpy as np

from drape.body.skeleton import JOINT_NAMES
from drape.errors import MeshError
from drape.garment.contours import TRUNK, bone_chains, open_contours, place_of
from drape.garment.files.mesh import GarmentMesh
from drape.garment.sheets import point_words

WORDS = {"collar": "side of the neck", "spine3": "chest", "spine2": "ribs", "spine1": "waist", "pelvis": "hips"}


class ScanFault(MeshError):
    """A refusal of a scan with a fault that cannot be repaired safely. ``points`` (P, 3) are its places on the
    ``mesh``, in the mesh's coordinates."""

    mesh: GarmentMesh | None = None
    points: np.ndarray = np.zeros((0, 3))

    def at(self, mesh: GarmentMesh, points: np.ndarray) -> ScanFault:
        """The same fault with its place."""
        self.mesh, self.points = mesh, np.asarray(points, dtype=np.float64).reshape(-1, 3)
        return self


def in_box(point: np.ndarray, vertices: np.ndarray) -> str:
    """Where ``point`` is in the garment's own box, for a file whose body is not known; its front is at +z, up at +y."""
    low, size = vertices.min(axis=0), np.maximum(np.ptp(vertices, axis=0), 1e-300)
    across, up, out = (point - low) / size
    side = "left" if across > 0.6 else "right" if across < 0.4 else "middle"
    return (
        f"{'front' if out >= 0.5 else 'back'}, {side}, {100 * up:.0f} % of the height from below, at "
        f"{point_words(point)} of the file"
    )


def on_body(point: np.ndarray, mesh: GarmentMesh, joints: np.ndarray) -> str:
    """Where ``point`` [m] (3,) is on a garment worn by a body with ``joints`` [m] (24, 3).

    For example "near the left shoulder, 12 cm from the hem at (0.2, 1.1, 0.05) m".
    """
    joint = JOINT_NAMES[int(np.linalg.norm(joints - point, axis=1).argmin())]
    side, _, part = joint.rpartition("_")
    name = WORDS.get(part, part)
    words = f"near the {side} {name}" if side else f"near the {name}"
    found = opening_names(mesh, joints)
    if found:
        nearest, away = min(
            ((text, float(np.linalg.norm(line - point, axis=1).min())) for text, line in found), key=lambda one: one[1]
        )
        words += f", {100 * away:.0f} cm from the {nearest}"
    return f"{words} at {point_words(point)} m"


def opening_names(mesh: GarmentMesh, joints: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """The openings that the body goes through, by name, and their points [m] (n, 3)."""
    chains = bone_chains(joints)
    trunk, named = [], []
    for contour in open_contours(mesh.vertices, mesh.faces):
        place = place_of(contour, chains)
        if place.part == TRUNK:
            trunk.append(contour)
        elif place.part is not None:
            named.append((f"{place.part.replace('_', ' ')}'s opening", contour.points))
    trunk.sort(key=lambda contour: -contour.centre[1])
    names = ["upper opening", *["opening round the trunk"] * (len(trunk) - 2), "hem"][-len(trunk) :] if trunk else []
    return named + [(name, contour.points) for name, contour in zip(names, trunk, strict=True)]
