"""The ways of cloth round a body by geometry alone: placed panels stand up clear of it, a garment goes into a pose.

A file places panels round the body that it was drawn for. Base patterns use the axes of the wearer's file, files of
Garment-Pattern-Generator those of SMPL's template, files of GarmentCode stand on the floor. A draped garment goes from
one pose to another with its bones, in small steps, off the skin.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

import numpy as np
import scipy.sparse
from scipy.sparse import csgraph

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES
from drape.cloth.relaxation import Distance
from drape.errors import InputError, MotionError, NotFound
from drape.garment.avatars import Avatar
from drape.garment.rest_pose import WEIGHT_SMOOTHING_M, smoother, surface_weights
from drape.geometry import meshes
from drape.geometry.meshes import boundary_loops
from drape.geometry.skinning import skin_points
from drape.motion.readers import read_motion
from drape.motion.samples import SAMPLES
from recovery.drape.seam_threads import in_numpy, sewn_relaxation
from recovery.pattern.measurements import measure_body
from recovery.pattern.pattern_mesh import PatternMesh
from recovery.pattern.sewing_pattern import PanelPlacement, Pattern
from recovery.sim.skin_contact import GridDistance

SMPL_PELVIS_M = (0.0, -0.235, 0.0)  # first joint of SMPL's templates, about
CLEARANCE_M = 0.015  # panels start at least this far off the skin
CLEAR_STEP_M, CLEAR_LIMIT_M = 0.005, 0.6
LEVELS_M = 0.01 * np.arange(-10, 16)  # heights that are tried beside the file's
LEVEL_PRICE = 1e-3  # metres of depth that a metre of lift costs, so that a level that fits is left alone
THREAD_SAMPLES = 9
FAR_M = 0.30  # a garment whose top is farther from neck, chest and waist was drawn in other axes or for nobody's trunk
BESIDE = 0.4  # least distance of an opening's centre from the middle plane over its width: 0.5 if it touches it
STANDS_RAD = 0.35  # between sleeve and arm: threads close nearer ones round the arm as they stand
LARGEST_TURN_RAD = 0.35  # the most that a joint turns in one step
STEP_GRID_M = 0.02  # the body's distance between the first and the last pose need not be fine
CARRY_GAP_M = 0.008
ROUNDS = 40  # rounds of relaxation after every step


class Axes(StrEnum):
    """The axes of a file's placements: those of the ``BODY``'s file, of SMPL's template, or with the origin on the
    ``FLOOR`` below the pelvis.

    ``AUTO`` takes those in which the garment's top is nearest to neck, chest or waist.
    """

    AUTO = "auto"
    BODY = "body"
    SMPL = "smpl"
    FLOOR = "floor"


@dataclass(frozen=True, eq=False)
class PlacedPanels:
    """Panel vertices ``positions`` [m] (P, 3) around the body, clear of it, and how they were brought there.

    The file's placements were read in ``axes``. All panels were then lifted by ``lift_m``, each moved outward by at
    most ``outward_m``, and sleeves turned onto the arms by at most ``turned_rad``. ``hangs_from`` is "shoulders",
    "chest" or "waist". ``limbs`` names the limbs that have an opening of their own, such as "left_arm".
    """

    positions: np.ndarray
    axes: Axes
    lift_m: float
    outward_m: float
    hangs_from: str
    turned_rad: float = 0.0
    limbs: tuple[str, ...] = ()


def scale_pattern(pattern: Pattern, factor: float) -> Pattern:
    """Returns ``pattern`` scaled by ``factor``, the panels' outlines and translations alike. Raises ``InputError`` for
    a factor outside 0.5 to 2."""
    if not 0.5 <= factor <= 2.0:
        raise InputError("scale", expected="a factor from 0.5 to 2", got=f"{factor}", cure="Draft a new size instead.")

    def grown(placement: PanelPlacement) -> PanelPlacement:
        x, y, z = (value * factor for value in placement.translation_m)
        return replace(placement, translation_m=(x, y, z))

    panels = tuple(replace(p, vertices=p.vertices * factor, placement=grown(p.placement)) for p in pattern.panels)
    return replace(pattern, panels=panels)


def place_panels(mesh: PatternMesh, body: BodyModel, distance: Distance, *, axes: Axes = Axes.AUTO) -> PlacedPanels:
    """Returns the panels of ``mesh`` placed round ``body`` in the T-pose, whose signed distance is ``distance``.

    The height is the one at which straight threads between sewn edges lie least deep in the body. Sleeves that point
    elsewhere than the arms are turned first. Raises ``InputError`` where all panels lie in one place, the garment
    begins far from neck, chest and waist, or a panel cannot be moved clear of the body.
    """
    check_placed(mesh.pattern)
    flat = mesh.placed()
    size = measure_body(body)
    top = float(flat[:, 1].max())
    holds = {"shoulders": size.neck_y, "waist": size.waist_y}
    if tube := len(boundary_loops(mesh.faces)) == 2:  # neither arms nor legs: its upper edge may be tight on the chest
        holds["chest"] = size.underarm_y
    pelvis, floor = body.joints_template[0], float(body.v_template[:, 1].min())
    origins = {
        Axes.BODY: np.zeros(3),
        Axes.SMPL: pelvis - np.array(SMPL_PELVIS_M),
        Axes.FLOOR: np.array([pelvis[0], floor, pelvis[2]]),
    }
    miss = {
        (name, hold): abs(top + origin[1] - height)
        for name, origin in origins.items()
        for hold, height in holds.items()
        # A tube's chest in the body's axes is a waist or a neck in others'.
        if axes in (Axes.AUTO, name) and (hold == "waist" or not tube or name in (Axes.BODY, axes))
    }
    chosen, hold = min(miss, key=lambda pair: miss[pair])
    if miss[chosen, hold] > FAR_M:
        raise InputError(
            "placement",
            expected="a garment that begins near the neck, the chest or the waist",
            got=f"its highest point {100 * miss[chosen, hold]:.0f} cm from them",
            cure="Say which axes the panels were placed in (--axes), and check the file's unit.",
        )
    stood = flat + origins[chosen]
    openings = openings_of_limbs(mesh, stood, top=hold == "shoulders", crotch_m=size.crotch_y)
    joints = dict(zip(JOINT_NAMES, body.joints_template, strict=True))
    mesh, turned = round_spread_arms(mesh, openings, joints)
    stood, still = mesh.placed() + origins[chosen], (mesh.placed() == flat).all(axis=1)
    # Turned sleeves are left out: beside the arms, too low, they would touch the body less than round them.
    lift = best_lift(stood, mesh.seam_pairs[still[mesh.seam_pairs].all(axis=1)], distance)
    stood = stood + np.array([0.0, lift, 0.0])
    if turned:  # threads close a sleeve round the arm that is in the middle of its cuff
        cuffs = np.concatenate(list(openings.values()))
        stood[~still, 1] += joints["left_elbow"][1] - mesh.nodes_from(stood)[cuffs, 1].mean()
    positions, outward = move_clear(mesh, stood, distance)
    return PlacedPanels(positions, chosen, lift, outward, hold, turned, tuple(openings))


def check_placed(pattern: Pattern) -> None:
    """Raises ``InputError`` for a pattern of several panels that all have the same placement."""
    spots = {(panel.placement.rotation_deg, panel.placement.translation_m) for panel in pattern.panels}
    if len(pattern.panels) > 1 and len(spots) == 1:
        raise InputError(
            "placement",
            expected="every panel with its own place round the body",
            got=f"{len(pattern.panels)} panels in one place",
            cure="Give each panel a translation and a rotation, as Garment-Pattern-Generator and GarmentCode do.",
        )


def best_lift(positions: np.ndarray, pairs: np.ndarray, distance: Distance) -> float:
    """Returns the lift [m] of panel vertices at ``positions`` [m] (P, 3) at which straight threads between ``pairs``
    (S, 2) of them lie least deep in the body; 0 without pairs."""
    if not len(pairs):
        return 0.0
    share = np.linspace(0.0, 1.0, THREAD_SAMPLES)[:, None, None]
    threads = ((1.0 - share) * positions[pairs[:, 0]] + share * positions[pairs[:, 1]]).reshape(-1, 3)
    costs = []
    for level in LEVELS_M:
        depth = np.maximum(0.0, -distance(threads + np.array([0.0, level, 0.0]))[0])
        costs.append(float(depth.reshape(THREAD_SAMPLES, -1).max(axis=0).mean()) + LEVEL_PRICE * abs(level))
    return float(LEVELS_M[int(np.argmin(costs))])


def move_clear(
    mesh: PatternMesh, positions: np.ndarray, distance: Distance, *, leave: Collection[str] = ()
) -> tuple[np.ndarray, float]:
    """Returns ``positions`` [m] (P, 3) with every panel moved along its normal until it is ``CLEARANCE_M`` off the
    body, and the longest such move [m].

    Panels named in ``leave`` stay where they are. Raises ``InputError`` for a panel that is not clear after
    ``CLEAR_LIMIT_M``.
    """
    moved, longest = positions.copy(), 0.0
    for number, panel in enumerate(mesh.pattern.panels):
        if panel.name in leave:
            continue
        mine = mesh.panel == number
        normal = panel.placement.matrix()[:, 2]
        for way in np.arange(0.0, CLEAR_LIMIT_M, CLEAR_STEP_M):
            shifted = positions[mine] + way * normal
            if distance(shifted)[0].min() >= CLEARANCE_M:
                moved[mine], longest = shifted, max(longest, float(way))
                break
        else:
            raise InputError(
                f"panel {panel.name}",
                expected="a place beside the body, its right side outward",
                got=f"a panel in the body, also {100 * CLEAR_LIMIT_M:.0f} cm further out",
                cure="Correct its translation, or turn it so that its right side faces away from the wearer.",
            )
    return moved, longest


# --- openings of limbs, and sleeves ----------------------------------------------------------------------------------


def openings_of_limbs(mesh: PatternMesh, placed: np.ndarray, *, top: bool, crotch_m: float) -> dict[str, np.ndarray]:
    """Returns the opening for each arm of a ``top``, or for each leg of another garment: its nodes (n,), in order, by
    the limb's name, such as "left_arm". Panel vertices are ``placed`` at [m] (P, 3).

    A top with three openings, two of them below the height ``crotch_m`` [m], has legs and no arms.
    """
    nodes, loops = mesh.nodes_from(placed), meshes.boundary_loops(mesh.faces)
    beside = [loop for loop in loops if abs(nodes[loop, 0].mean()) > BESIDE * np.ptp(nodes[loop, 0])]
    beside.sort(key=lambda loop: float(nodes[loop, 1].mean()))  # the uppermost on a side stays: below it may be a leg's
    limb = "arm" if top and (len(loops) > 3 or any(nodes[loop, 1].mean() > crotch_m for loop in beside)) else "leg"
    return {f"{'left' if nodes[loop, 0].mean() > 0.0 else 'right'}_{limb}": loop for loop in beside}


def sleeve_panels(mesh: PatternMesh, cuff: np.ndarray) -> np.ndarray:
    """Returns the numbers (n,) of the panels that lie nearest, along the cloth, to the opening with the nodes ``cuff``
    (m,), and touch no other opening."""
    edges = meshes.unique_edges(mesh.panel_faces)
    lengths = np.concatenate([meshes.edge_lengths(mesh.rest, edges), np.full(len(mesh.seam_pairs), 1e-9)])
    ends = np.concatenate([edges, mesh.seam_pairs]).T
    graph = scipy.sparse.csr_matrix((lengths, ends), shape=(len(mesh.rest),) * 2)
    own = np.isin(mesh.node_of_panel_vertex, cuff)
    other = np.isin(mesh.node_of_panel_vertex, meshes.boundary_vertices(mesh.faces)) & ~own
    near, far = (csgraph.dijkstra(graph, False, np.flatnonzero(rim), min_only=True) for rim in (own, other))
    return np.setdiff1d(np.flatnonzero(np.bincount(mesh.panel, near - far) < 0.0), mesh.panel[other])


def round_spread_arms(
    mesh: PatternMesh, openings: Mapping[str, np.ndarray], joints: Mapping[str, np.ndarray]
) -> tuple[PatternMesh, float]:
    """Returns ``mesh`` with the placements of its sleeves turned so that these point as the arms do, and the largest
    turn [rad].

    ``openings`` has the nodes (n,) of each cuff by the limb's name, ``joints`` the body's joints [m] (3,) by name. A
    sleeve points to where its cloth ends in its cuff. One that points elsewhere than its arm is turned about the z axis
    and moved in x and y to its armhole. Without such a sleeve the turn is 0.
    """
    plane, panels, largest = mesh.placed() @ [1.0, 1.0j, 0.0], list(mesh.pattern.panels), 0.0
    for side in (limb.removesuffix("arm") for limb in openings if limb.endswith("arm")):
        cuff = np.isin(mesh.node_of_panel_vertex, openings[f"{side}arm"])
        # Outward lies a quarter turn to the right of an edge, seen from outside: panels run counter-clockwise.
        ends = [(panels[mesh.panel[v[0]]], v) for v in mesh.edge_vertices.values() if cuff[v].all()]
        across = (
            p.placement.matrix()[:2, :2] @ [[0.0, 1.0], [-1.0, 0.0]] @ (mesh.rest[v[-1]] - mesh.rest[v[0]])
            for p, v in ends
        )
        arm, way = joints[f"{side}wrist"] - joints[f"{side}shoulder"], sum(across, np.zeros(2))
        turn = float(np.angle(complex(arm[0], arm[1]) * complex(way[0], -way[1])))
        sleeve = sleeve_panels(mesh, openings[f"{side}arm"])
        own = np.isin(mesh.panel[mesh.seam_pairs], sleeve)
        armhole, own = mesh.seam_pairs[own[:, 0] != own[:, 1]], own[own[:, 0] != own[:, 1]]
        if abs(turn) < STANDS_RAD or not len(armhole):
            continue
        spin, largest = np.exp(1.0j * turn), max(largest, abs(turn))
        shift = plane[armhole[~own]].mean() - spin * plane[armhole[own]].mean()
        for number in sleeve:
            (a, b, c), (x, y, z) = panels[number].placement.rotation_deg, panels[number].placement.translation_m
            at = spin * complex(x, y) + shift
            turned = PanelPlacement((a, b, c + float(np.degrees(turn))), (at.real, at.imag, z))
            panels[number] = replace(panels[number], placement=turned)
    return replace(mesh, pattern=replace(mesh.pattern, panels=tuple(panels))) if largest else mesh, largest


def read_pose(text: str) -> np.ndarray:
    """Returns the pose [rad] (24, 3) that ``text`` names: ``CLIP:FRAME`` or ``CLIP`` (frame 0) of a motion file or a
    sample, or a JSON file.

    The JSON holds 72 numbers, or an object with them under "pose". Translations are left out. Raises ``NotFound`` for
    no such file, ``MotionError`` for a frame that the clip does not have and for JSON that is no pose.
    """
    name, _, frame_text = text.rpartition(":")
    if not (name and frame_text.lstrip("-").isdigit()):
        name, frame_text = text, "0"
    path = Path(name)
    if name not in SAMPLES and not path.is_file():
        raise NotFound(
            "pose",
            expected=f"a motion or JSON file, or one of {', '.join(sorted(SAMPLES))}; :FRAME behind it",
            got=text,
            cure="Check the path.",
        )
    if path.suffix == ".json":
        return _json_pose(path)
    clip = SAMPLES[name]() if name in SAMPLES else read_motion(path)
    frame, count = int(frame_text), len(clip.poses)
    if not -count <= frame < count:
        raise MotionError(
            "pose", expected=f"a frame from 0 to {count - 1}", got=frame_text, cure="Take a frame that the clip has."
        )
    return np.array(clip.poses[frame])


def _json_pose(path: Path) -> np.ndarray:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
        value = value["pose"] if isinstance(value, dict) else value
        pose = np.array(value, dtype=np.float64).reshape(JOINT_COUNT, 3)
    except (ValueError, KeyError, TypeError) as error:
        raise MotionError(
            path.name,
            expected=f"{3 * JOINT_COUNT} numbers [rad], alone or under 'pose'",
            got=f"{error}",
            cure="Write SMPL's axis-angles, joint after joint.",
        ) from error
    if not np.isfinite(pose).all():
        raise MotionError(path.name, expected="finite numbers", got="NaN or infinity", cure="Correct the pose.")
    return pose


def posed_joints(body: BodyModel, pose: np.ndarray | None) -> np.ndarray:
    """Returns the joints [m] (24, 3) of ``body`` in ``pose`` [rad] (24, 3), or for None in the T-pose."""
    return body.joints_template if pose is None else body.posed_joints(pose[None])[0]


def pose_steps(pose: np.ndarray) -> np.ndarray:
    """Returns poses [rad] (S, 24, 3) on the way from the T-pose, which is left out, to ``pose`` (24, 3); every joint
    turns evenly about its own axis."""
    angles = np.linalg.norm(pose[1:], axis=1)  # the root's turn needs no steps: body and garment turn as one
    steps = max(1, int(np.ceil(angles.max() / LARGEST_TURN_RAD)))
    return np.linspace(0.0, 1.0, steps + 1)[1:, None, None] * pose


def move_with_bones(
    nodes: np.ndarray, faces: np.ndarray, body: BodyModel, before: np.ndarray, after: np.ndarray
) -> np.ndarray:
    """Returns garment ``nodes`` [m] (N, 3) on the body in pose ``before`` [rad] (24, 3), moved by skinning to pose
    ``after``."""
    rotations, translations = body.bones(np.stack([before, after]))
    skin = Avatar(body.posed_vertices(before[None])[0], body.faces, 0.0, "posed body")
    weights = smoother(nodes, faces, WEIGHT_SMOOTHING_M)(surface_weights(nodes, skin) @ body.weights)
    weights = weights / weights.sum(axis=1, keepdims=True)
    turn = rotations[1] @ rotations[0].transpose(0, 2, 1)
    shift = translations[1] - np.einsum("jab,jb->ja", turn, translations[0])
    return np.asarray(skin_points(nodes, weights, turn, shift))


def to_pose(mesh: PatternMesh, nodes: np.ndarray, body: BodyModel, pose: np.ndarray) -> np.ndarray:
    """Returns garment ``nodes`` [m] (N, 3) on ``body`` in the T-pose, carried to ``pose`` [rad] (24, 3): clear of the
    skin, but not at rest."""
    before = np.zeros((JOINT_COUNT, 3))
    for after in pose_steps(pose):
        nodes = move_with_bones(nodes, mesh.faces, body, before, after)
        skin = body.posed_vertices(after[None])[0]
        distance = in_numpy(GridDistance.from_mesh(skin, body.faces, spacing_m=STEP_GRID_M))
        relaxation = sewn_relaxation(mesh, distance, gap_m=CARRY_GAP_M)
        for _ in range(ROUNDS):
            nodes = relaxation.step(nodes)
        before = after
    return nodes
