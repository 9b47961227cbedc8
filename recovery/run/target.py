"""Reads a target: one garment's surface, in metres, on the body it was draped on; repaired with a note, or refused.

A fault that has one repair (copies of vertices, faces without area, branches, second layers, crumbs, holes, unit, axis,
sides) is repaired, with a note in the report. A fault that needs a choice (which of two garments) is refused with its
place and the cure.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from drape.errors import InputError, MeshError
from drape.garment.avatars import Avatar
from drape.garment.borders import Loop, borders, plainly_hole, plainly_opening
from drape.garment.contours import TRUNK, bone_chains, open_contours, part_round, place_of
from drape.garment.files.mesh import GarmentMesh, read_mesh, weld
from drape.garment.mesh_checks import Unit, Up, check_area, check_arrays, orient_outward, place, without_flat_faces
from drape.garment.sheets import agreeing, cut_branches, main_sheet, without_copies
from drape.geometry import closest, meshes
from recovery import progress
from recovery.scan.closed_ends import check_unworn
from recovery.scan.hems import without_turned_hems
from recovery.scan.holes import closed
from recovery.scan.places import ScanFault, in_box
from recovery.scan.thin import calmed, thinned
from recovery.sim.skin_contact import SkinContact

SCAN_VERTEX_LIMIT = 3_300_000  # 1,000,000 triangles of an STL, which does not share vertices
FAR_M = 0.12  # median distance from the skin: the loosest garment hangs nearer
EXTENTS = (1e-3, 1e6)  # in a file's unit, whatever it is: squares and cubes stay far from the ends of the numbers
DEEP_M, DEEP_SHARE = 0.02, 0.2  # the target goes through the body where more than this share lies deeper than that
LYING_SHARE = 0.05  # of the cloth, nearest to the skin, lies on it
LEAST_OFF_M, MOST_OFF_M = 0.001, 0.006  # beyond our own gap: less is the same, more is a garment that lies nowhere
OPEN_SHARE = 0.7  # of the height: no hem and no neckline, however deep, goes that far
TWISTED_SHARE = 0.02  # of the faces: more edges to be cut, and the scan is no cloth
# Openings round each part of the body, by base.
OF_TOPS = {TRUNK: 2, "left_arm": 1, "right_arm": 1}
OF_TUBES = {TRUNK: 2}
OPENINGS = {
    **dict.fromkeys(("tshirt", "tank", "dress", "sleeved_dress"), OF_TOPS),
    "trousers": {TRUNK: 1, "left_leg": 1, "right_leg": 1},
    **dict.fromkeys(("skirt", "tube", "strapless_dress"), OF_TUBES),
}


def read_target(path: Path, *, label: str | None = None) -> GarmentMesh:
    """The garment in ``path``: one sheet of agreeing faces whose plain holes are closed, in the file's coordinates.

    ``label`` keeps the faces of one material. Raises ``ScanFault`` with the place for two garments and for one-sided
    cloth, ``MeshError`` for a solid without openings.
    """
    with progress.stage(f"{path.name} is read"):
        mesh = read_mesh(path, vertex_limit=SCAN_VERTEX_LIMIT)
    if label is not None:
        mesh = labelled(mesh, label)
    with progress.stage("the scan is mended"):
        check_arrays(mesh, vertex_limit=SCAN_VERTEX_LIMIT)
        if not EXTENTS[0] <= (extent := float(np.ptp(mesh.vertices, axis=0).max())) <= EXTENTS[1]:
            raise MeshError(
                "target",
                expected="a garment in m, cm, dm, mm or inch",
                got=f"{extent:.3g} across",
                cure="Scale the file.",
            )
        return mended(mesh)


def mended(mesh: GarmentMesh) -> GarmentMesh:
    """``mesh`` as one sheet: every edge has one face or two, neighbours agree, plain holes and bites are closed."""
    progress.tick("copies and flat faces")
    mesh = without_flat_faces(without_copies(weld(mesh)))
    progress.tick("branches")
    mesh = one_sheet(cut_branches(mesh))
    progress.tick("thinning out")
    thin = thinned(mesh)
    if thin is not mesh:
        mesh = one_sheet(cut_branches(without_flat_faces(thin)))
    mesh = without_turned_hems(calmed(two_sided(mesh)))
    check_open(mesh, "a closed surface")
    closing = closed(mesh, lambda one: plainly_hole(one, mesh))
    check_open(closing.mesh, f"one that is closed once mended, with no border but holes ({closing.holes})")
    check_closed_round(closing.mesh)
    check_unworn(closing.mesh)
    return closing.mesh if closing.mesh is mesh else closing.mesh.noted(*closing.words(len(mesh.faces)))


def check_open(mesh: GarmentMesh, otherwise: str) -> None:
    """Refuses a mesh without borders; the refusal says that it is ``otherwise``."""
    if not meshes.boundary_loops(mesh.faces):
        raise MeshError(
            "target",
            expected="a garment: a surface with openings",
            got=otherwise,
            cure="Cut the garment out of the scan, without the body, and open neck, cuffs and hem.",
        )


def check_closed_round(mesh: GarmentMesh) -> None:
    """Refuses a jacket whose front is open: its longest border goes round the hem and up to the neck."""
    points = mesh.vertices[borders(mesh)[0].loop]
    low, size = mesh.vertices.min(axis=0), np.ptp(mesh.vertices, axis=0)
    # y or z is up, the other one the depth, which every hem has.
    if (np.ptp(points, axis=0) < OPEN_SHARE * size)[1:].any():
        return
    up = 1 if size[1] > size[2] else 2
    height = (points[:, up] - low[up]) / size[up]
    edges = points[np.abs(height - height[np.abs(height - 0.5).argmin()]) < 0.2]
    raise ScanFault(
        "target",
        expected="a garment that is closed all round",
        got=f"one that is open from hem to neck, as a jacket's front is: {in_box(edges[0], mesh.vertices)}",
        cure="Join the two edges (button it up): no base opens in front.",
    ).at(mesh, edges)


def labelled(mesh: GarmentMesh, label: str) -> GarmentMesh:
    """The faces of ``mesh`` whose material is called ``label``."""
    if label not in mesh.material_names:
        raise MeshError(
            "--label",
            expected=f"one of {', '.join(mesh.material_names)}",
            got=label,
            cure="Name a material of the file.",
        )
    keep = mesh.face_material == mesh.material_names.index(label)
    if not keep.any():
        raise MeshError("--label", expected=f"faces of {label}", got="none", cure="Name another material of the file.")
    return mesh.take_faces(keep).noted(f"kept {int(keep.sum())} of {len(keep)} faces: those of material {label}")


def one_sheet(mesh: GarmentMesh) -> GarmentMesh:
    """The largest sheet of ``mesh``; refuses a second one that lies apart and is large."""
    kept, rivals = main_sheet(mesh)
    if rivals:
        labels = f" Materials: {', '.join(mesh.material_names)}." if len(mesh.material_names) > 1 else ""
        raise ScanFault(
            "target",
            expected="one garment in one piece",
            got=f"{len(rivals) + 1} pieces of cloth; another one is {in_box(rivals[0], mesh.vertices)}",
            cure=f"Save the garment alone, name its material (--label), or join what was torn.{labels}",
        ).at(mesh, np.array(rivals))
    return kept


def two_sided(mesh: GarmentMesh) -> GarmentMesh:
    """``mesh`` with neighbours that agree in orientation, cut where a strip is twisted; refuses what is no cloth."""
    turned, cuts = agreeing(mesh)
    if len(cuts) > TWISTED_SHARE * len(mesh.faces):
        raise ScanFault(
            "target",
            expected="cloth with two sides",
            got=f"{len(cuts)} edges at which it turns to its other side, the first {in_box(cuts[0], mesh.vertices)}",
            cure="Let the scanner make a surface whose faces agree.",
        ).at(mesh, cuts)
    if not len(cuts):
        return turned
    words = f"cut open a twisted strip at {len(cuts)} edges, the first {in_box(cuts[0], mesh.vertices)}"
    return one_sheet(turned.noted(words))


def placed_target(mesh: GarmentMesh, skin: Avatar, *, unit: Unit = "auto", up: Up = "auto") -> GarmentMesh:
    """``mesh`` in metres, y up, on ``skin``, with normals outward; refuses one that does not lie on it."""
    if not len(mesh.uv):
        mesh = replace(mesh, uv_faces=np.zeros((0, 3), dtype=np.int64))
    mesh = orient_outward(place(mesh, skin, unit=unit, up=up), skin)
    check_near(mesh, skin)
    check_area(mesh, "target area")
    return mesh


def check_near(mesh: GarmentMesh, skin: Avatar) -> None:
    """Refuses a target that hangs in the air beside the body, or that goes through it."""
    step = max(1, len(mesh.vertices) // 2000)
    distance = closest.signed_distance(mesh.vertices[::step], skin.vertices, skin.faces)
    cure = "Move the target onto the body it was draped on, name its pose (--pose), or fit a body in it (--body fit)."
    if (middle := float(np.median(distance))) > FAR_M:
        raise InputError(
            "target",
            expected=f"cloth on the body, half of it within {100 * FAR_M:.0f} cm of the skin",
            got=f"half of it more than {100 * middle:.0f} cm away",
            cure=cure,
        )
    if (deep := float((distance < -DEEP_M).mean())) > DEEP_SHARE:
        raise InputError(
            "target",
            expected="cloth outside the body",
            got=f"{100 * deep:.0f} % of it more than {100 * DEEP_M:.0f} cm inside",
            cure=cure,
        )


def opened(
    mesh: GarmentMesh, joints: np.ndarray, wanted: dict[str, int] | None = None
) -> tuple[GarmentMesh, dict[str, int]]:
    """Returns ``mesh`` with all borders closed that are no openings, and how many openings each part of the body has.

    ``joints`` [m] (24, 3) are the body's. An opening is a border that bones pass through, or a folded cuff beside them.
    If a part has more than ``wanted``, those that lie in the cloth are taken for holes: the body's fit may have put a
    leg behind a hole.
    """
    chains = bone_chains(joints)
    loops = {one.loop.tobytes(): one for one in borders(mesh)}
    openings: dict[str, list[Loop]] = {}
    for contour in open_contours(mesh.vertices, mesh.faces):
        one, passed = loops[contour.loop.tobytes()], part_round(contour, chains)
        part = passed or place_of(contour, chains).part
        if part is not None and (passed or (plainly_opening(one) and not plainly_hole(one, mesh))):
            openings.setdefault(part, []).append(one)
    kept = set()
    for part, found in openings.items():
        found.sort(key=lambda one: one.flatness)
        enough = len(found) if wanted is None else wanted.get(part, 0)
        kept |= {one.loop.tobytes() for n, one in enumerate(found) if n < enough or plainly_opening(one)}
    done = closed(mesh, lambda one: one.loop.tobytes() not in kept, lambda one: True)
    there: dict[str, int] = {}
    for contour in open_contours(done.mesh.vertices, done.mesh.faces):
        if (part := place_of(contour, chains).part) is not None:
            there[part] = there.get(part, 0) + 1
    return (mesh if done.mesh is mesh else done.mesh.noted(*done.words(len(mesh.faces)))), there


def check_base(base: str, found: dict[str, int]) -> None:
    """Refuses (``InputError``) a target whose openings, ``found`` by part of the body, are not those of the base called
    ``base``. A base that is no name of ours passes."""
    wanted = OPENINGS.get(base)
    if wanted is None:
        return
    missing = {part for part, count in wanted.items() if found.get(part, 0) < count}
    foreign = set(found) - set(wanted)
    if missing or foreign:
        fitting = [name for name, kind in OPENINGS.items() if kind == found]
        raise InputError(
            "target",
            expected=f"the openings of a {base}: {describe_openings(wanted)}",
            got=describe_openings(found) or "no opening that the body goes through",
            cure=f"Take --base {' or '.join(fitting)}."
            if fitting
            else "Take a base of the target's kind, and open what is shut.",
        )


def describe_openings(found: dict[str, int]) -> str:
    """A phrase such as "2 round the trunk, 1 round the left arm"."""
    return ", ".join(f"{count} round the {part.replace('_', ' ')}" for part, count in sorted(found.items()))


def off_skin(mesh: GarmentMesh, skin: Avatar, known: np.ndarray) -> float:
    """Returns how much farther [m] off the skin the cloth of ``mesh`` rests than ours, since it has a thickness, or its
    simulator kept a gap. 0 if that is less than a millimetre.

    It is the distance below which the share ``LYING_SHARE`` of the area of the ``known`` faces (F,) lies, less the gap
    of our contact.
    """
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    distance = closest.signed_distance(middles, skin.vertices, skin.faces)
    order = np.argsort(distance)
    area = (meshes.face_areas(mesh.vertices, mesh.faces) * known)[order]
    lies = float(distance[order][np.searchsorted(np.cumsum(area), LYING_SHARE * area.sum())])
    more = lies - SkinContact.gap_m
    return min(more, MOST_OFF_M) if more >= LEAST_OFF_M else 0.0
