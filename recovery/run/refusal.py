"""The refusal of a scan with a fault: its place in words, on the wearer where there is one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drape.body.skeleton import JOINT_NAMES
from drape.errors import InputError
from drape.garment.contours import TRUNK, bone_chains, open_contours, place_of
from drape.garment.files.mesh import GarmentMesh
from drape.garment.mesh_checks import place_on_avatar
from drape.garment.sheets import point_words
from recovery.drape.placement import posed_joints
from recovery.run.target import read_target_wearer
from recovery.run.task import FIT_INSIDE, RecoveryJob
from recovery.scan.repair import ScanFault

WORDS = {"collar": "side of the neck", "spine3": "chest", "spine2": "ribs", "spine1": "waist", "pelvis": "hips"}


def placed_fault(fault: ScanFault, job: RecoveryJob) -> ScanFault:
    """Returns ``fault`` with the scan moved onto the wearer of ``job``, in metres, and words on where on the wearer the
    fault lies; ``fault`` itself where no wearer is given or the scan does not lie on it."""
    if fault.mesh is None or job.body == FIT_INSIDE:
        return fault
    wearer = read_target_wearer(job.body, betas=job.betas, pose=job.pose)
    try:
        both = replace(fault.mesh, vertices=np.concatenate([fault.mesh.vertices, fault.points]))
        both = place_on_avatar(both, wearer.skin, unit=job.unit, up=job.up).vertices
    except InputError:
        return fault
    count = len(fault.mesh.vertices)
    placed, points = replace(fault.mesh, vertices=both[:count]), both[count:]
    joints = posed_joints(wearer.shaped, wearer.pose) + wearer.trans
    words = on_body(points[0], placed, joints)
    return ScanFault(fault.name, expected=fault.expected, got=f"{fault.got}; {words}", cure=fault.cure).at(
        placed, points
    )


def on_body(point: np.ndarray, mesh: GarmentMesh, joints: np.ndarray) -> str:
    """Returns a phrase on where ``point`` [m] (3,) lies on a garment worn by a body with ``joints`` [m] (24, 3), such
    as "near the left shoulder, 12 cm from the hem at (0.2, 1.1, 0.05) m"."""
    joint = JOINT_NAMES[int(np.linalg.norm(joints - point, axis=1).argmin())]
    side, _, part = joint.rpartition("_")
    name = WORDS.get(part, part)
    words = f"near the {side} {name}" if side else f"near the {name}"
    if openings := opening_names(mesh, joints):
        away, nearest = min((float(np.linalg.norm(line - point, axis=1).min()), text) for text, line in openings)
        words += f", {100 * away:.0f} cm from the {nearest}"
    return f"{words} at {point_words(point)} m"


def opening_names(mesh: GarmentMesh, joints: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Returns the openings of ``mesh`` that a body with ``joints`` [m] (24, 3) goes through, each with its name and its
    points [m] (n, 3)."""
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
