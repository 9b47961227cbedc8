"""A user's character as it wears garments: its body, its rig, its own surface; made from its file and stored.

python -m drape.avatar.wearer FILE [--out DIR]
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy.sparse

from drape.avatar.attire import Attire, AttirePart, attire_of
from drape.avatar.avatar_body import avatar_body, enclosing_body
from drape.avatar.body_fit import fit_to
from drape.avatar.character import character_in
from drape.avatar.face_colours import face_colours
from drape.avatar.file_skeleton import FileRig, file_rig
from drape.avatar.mapping import NAMES, map_joints
from drape.avatar.own_clothes import Halves, layers_of, shrink
from drape.avatar.parts import PARTS, counted_vertices
from drape.avatar.shoes import shoes_height
from drape.avatar.t_pose import TPose, to_t_pose
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES
from drape.errors import ArtifactError, BodyError, DrapeError, MotionError, refusing
from drape.files.atomic import whole_file
from drape.files.gltf import GltfFile
from drape.files.packed import UNREADABLE, pack, read_packed
from drape.geometry.closest import closest_point
from drape.geometry.skinning import skin_points
from drape.motion.joint_names import ancestors
from drape.motion.rig_poses import UNIT_TOLERANCE, Rig, poses_to_rig, rig_to_poses

FORMAT_VERSION = 1
FIT_VERSION = 5  # It is raised when a change here changes the bodies that come out.
WORN_NOTHING = Attire((), np.zeros(0, dtype=np.int64), (0.8, 0.66, 0.56), np.zeros((0, 3)))
# A body whose median distance is larger is not the character's. A deeper trunk than ours raises the limit.
FIT_LIMIT_MM = 25.0
UPPER = "upper"  # In a file it names the body with the character's own trousers on.
LIMBS_M = {"leg": (0.25, 1.4), "arm": (0.15, 1.0), "trunk": (0.2, 0.9)}  # Garments can be cut for these lengths.


@dataclass(frozen=True, eq=False)
class Wearer:
    """A character that wears garments.

    ``body`` is the body that stands for it, and ``standard`` the one that this is made of. ``over`` is ``body`` with
    the character's own trousers on, None where it is not made yet. ``digest`` is the sha256 of its file, of
    ``standard``, of the version of the fit, and of the joints and kinds that a client has set.

    ``rig`` has its nodes, called as VRM calls them in a VRM; ``nodes`` are their own names. ``found_by``,
    ``confidence`` and ``notes`` are those of ``JointMapping``. ``vrm`` is the version "0" or "1" of a VRM, else "".

    Its surface has ``vertices`` [m] (V, 3) in T-pose in the frame of ``body``, ``faces`` (F, 3) and ``weights`` (V, 24)
    on SMPL's joints. ``median_mm`` and ``p95_mm`` are the median and the 95 % quantile of the distance of its trunk and
    limbs from ``body``. ``scale``: metres per unit of its file. ``attire``: what its faces are; it has no parts where
    an earlier version stored the character. ``file`` is the rig of its file, and ``painted`` (F,) bool are the faces of
    its body and of clothes that are one with it; both are None of a character that was stored (``load_file_rig``).
    """

    name: str
    digest: str
    standard: BodyModel
    body: BodyModel
    rig: Rig
    nodes: tuple[str, ...]
    vertices: np.ndarray
    faces: np.ndarray
    weights: np.ndarray
    scale: float
    height_m: float
    median_mm: float
    p95_mm: float
    vrm: str = ""
    found_by: str = NAMES
    confidence: float = 1.0
    notes: tuple[str, ...] = ()
    file: FileRig | None = None
    attire: Attire = WORN_NOTHING
    over: BodyModel | None = None
    painted: np.ndarray | None = None

    def body_under(self, halves: Halves) -> BodyModel:
        """Returns the body that garments on ``halves`` lie on: ``upper`` for the upper half alone, else ``body``."""
        return self.upper if halves == (True, False) else self.body

    @cached_property
    def upper(self) -> BodyModel:
        """The body below garments for the upper half alone: ``body`` with the character's own trousers on, or ``body``
        itself where it has none. It is made where it is not there yet, which takes a second."""
        return upper_body(self) if self.over is None else self.over

    @cached_property
    def shoes_m(self) -> float:
        """The height [m] in the frame of ``body`` at which its shoes end, minus infinity where none stands out
        (``shoes_height``)."""
        return shoes_height(self.body, self.vertices, self.faces, self.weights)

    @property
    def joints(self) -> dict[str, str]:
        """The names of its nodes by SMPL's names of joints."""
        return {joint: self.nodes[node] for joint, node in self.rig.sources.items()}

    def posed(self, poses: np.ndarray, trans: np.ndarray) -> np.ndarray:
        """Returns its surface [m] (F, V, 3) in the world, in SMPL ``poses`` (F, 24, 3) [rad] with the root displaced by
        ``trans`` [m] (F, 3)."""
        return skin_points(
            np.broadcast_to(self.vertices, (len(poses), *self.vertices.shape)),
            self.weights,
            *self.body.bones(poses, trans),
        )

    def from_rig(
        self, quaternions: Sequence[object] | np.ndarray, places: Sequence[object] | np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns SMPL poses (F, 24, 3) [rad] and root translations [m] (F, 3) for the local rotations ``quaternions``
        (F, N, 4), xyzw, of its N nodes.

        ``places`` [m] (F, 3): where the node of the pelvis is in the world; None: at rest. What is draped then lies in
        the world of the rig, in metres. Raises ``MotionError`` for what are no unit quaternions of its nodes.
        """
        xyzw = rotations(quaternions, len(self.nodes))
        rows, rig = self._read_nodes
        poses = rig_to_poses(rig, xyzw[:, rows][..., [3, 0, 1, 2]])
        rest = self.scale * self.rig.rest_positions[self.rig.sources["pelvis"]]
        at = np.broadcast_to(rest, (len(poses), 3)) if places is None else np.asarray(places, dtype=np.float64)
        return poses, at - self.body.joints_template[0]

    @cached_property
    def _read_nodes(self) -> tuple[np.ndarray, Rig]:
        """The nodes (n,) that turn a joint of ours, and the rig of these alone: of a face's bones no joint hears."""
        rig = self.rig
        rows = np.zeros(len(self.nodes), dtype=bool)
        for node in rig.sources.values():
            rows[ancestors(rig.parents, node)] = True
        place = np.cumsum(rows) - 1
        parents = [
            -1 if above < 0 else int(place[above]) for above, read in zip(rig.parents, rows, strict=True) if read
        ]
        nodes = {joint: int(place[node]) for joint, node in rig.sources.items()}
        names = [name for name, read in zip(rig.names, rows, strict=True) if read]
        less = replace(
            rig, names=names, parents=parents, nodes=nodes,
            rest_rotations=rig.rest_rotations[rows], rest_translations=rig.rest_translations[rows],
        )  # fmt: skip
        return np.flatnonzero(rows), less

    def to_rig(self, poses: np.ndarray, trans: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the local rotations (F, N, 4), unit quaternions xyzw, of its N nodes, and the positions [m] (F, 3) of
        the node of the pelvis, for SMPL ``poses`` (F, 24, 3) [rad] and root translations ``trans`` [m] (F, 3): the
        inverse of ``from_rig``."""
        return poses_to_rig(self.rig, poses)[..., [1, 2, 3, 0]], trans + self.body.joints_template[0]

    def file_name(self) -> str:
        """Returns the name of the file that ``save_wearer`` writes: the name and the first 16 digits of the digest."""
        return f"{self.name}-{self.digest[:16]}.npz"


def read_wearer(
    payload: bytes,
    *,
    name: str,
    body: BodyModel | None = None,
    joints: Mapping[str, str] | None = None,
    kinds: Mapping[str, str] | None = None,
    begun: Callable[[str], None] | None = None,
) -> Wearer:
    """Returns the wearer in the bytes of a GLB or VRM file, for garments of ``body``, the standard one by default.

    ``joints`` are those of ``map_joints``, and ``kinds`` the ``corrections`` of ``attire_of``. ``begun`` is called with
    the name of each stage as it begins: "read", "map", "fit". Raises ``MeshError``, ``MotionError``, ``BodyError`` or
    ``NotFound`` for what is no person with skeleton and skin.
    """
    begins = begun or (lambda stage: None)
    begins("read")
    body = load_body() if body is None else body
    file = GltfFile(payload, label=name)
    character = character_in(file)
    whole = file_rig(file, character)
    begins("map")
    match = map_joints(character.skinned, body, joints=joints, label=name)
    rig = match.rig
    pose = to_t_pose(character, rig)
    _check_limbs(pose, rig, name)
    assert character.triangle is not None
    colours = face_colours(file, character.primitives)[character.triangle]
    attire = attire_of(file, character, pose, colours, corrections=kinds)
    begins("fit")
    layers = layers_of(attire, pose)
    seen = shrink(pose, layers.hollow).only(layers.body | layers.hollow)
    fit = fit_to(seen, body)
    shaped = avatar_body(fit, seen, body, name=name, covered=pose.only(layers.felt))
    root = JOINT_NAMES.index("pelvis")
    surface = pose.vertices + shaped.joints_template[root] - pose.joints[root]
    distances_mm = 1e3 * closest_point(surface[counted_vertices(seen)], shaped.v_template, shaped.faces).distance
    limit_mm = FIT_LIMIT_MM * max(1.0, _depth_m(shaped) / _depth_m(body))
    median_mm, p95_mm = _checked_fit(distances_mm, limit_mm, name, match.notes)
    made_of = json.dumps([FIT_VERSION, body.digest, dict(joints or {}), dict(kinds or {})])
    digest = hashlib.sha256(made_of.encode() + payload).hexdigest()
    return Wearer(
        name, digest, body, shaped, rig, character.names, surface, pose.faces, pose.weights, pose.scale,
        pose.height_m, median_mm, p95_mm, character.vrm, match.by, match.confidence, match.notes, whole, layers.attire,
        painted=layers.body,
    )  # fmt: skip


def upper_body(wearer: Wearer) -> BodyModel:
    """Returns the body of ``wearer`` brought out to the trousers or skirt that it came in; its ``body`` itself where it
    has none, or where they are painted on its skin."""
    stored = (array.astype(np.float32).astype(np.float64) for array in (wearer.vertices, wearer.weights))
    vertices, weights = stored  # They are the same before the character is stored and after.
    pose = TPose(vertices, wearer.faces, weights, wearer.body.joints_template, wearer.scale, wearer.height_m)
    lower = layers_of(wearer.attire, pose).lower
    return enclosing_body(wearer.body, pose.only(lower), wearer.standard) if lower.any() else wearer.body


def _checked_fit(distances_mm: np.ndarray, limit_mm: float, name: str, notes: Sequence[str]) -> tuple[float, float]:
    """Median and 95 % of the distances [mm] of a character from its body; refuses those of another body."""
    median_mm, p95_mm = float(np.median(distances_mm)), float(np.quantile(distances_mm, 0.95))
    if not median_mm <= limit_mm:  # The median is NaN where nothing of it is trunk or limb.
        cure = " ".join([*(f"{note}." for note in notes), "Send a character with a body in a T- or A-pose."])
        got = f"{median_mm:.0f} mm"
        raise BodyError(name, expected=f"a body that ours fits to {limit_mm:.0f} mm", got=got, cure=cure)
    return median_mm, p95_mm


def _depth_m(body: BodyModel) -> float:
    """How far the trunk of ``body`` reaches from back to front."""
    trunk = body.weights[:, [JOINT_NAMES.index(name) for name in PARTS["trunk"]]].sum(axis=1) > 0.5
    return float(np.ptp(body.v_template[trunk, 2]))


def _check_limbs(pose: TPose, rig: Rig, name: str) -> None:
    """Refuses proportions that no garment of ours can be cut for."""
    at = {joint: pose.joints[index] for index, joint in enumerate(JOINT_NAMES) if joint in rig.sources}
    hips, shoulders = (0.5 * (at[f"left_{one}"] + at[f"right_{one}"]) for one in ("hip", "shoulder"))
    lengths = {
        "leg": np.linalg.norm(at["left_hip"] - at["left_knee"]) + np.linalg.norm(at["left_knee"] - at["left_ankle"]),
        "arm": np.linalg.norm(at["left_shoulder"] - at["left_elbow"])
        + np.linalg.norm(at["left_elbow"] - at.get("left_wrist", at["left_elbow"])),
        "trunk": np.linalg.norm(shoulders - hips),
    }
    for limb, (low, high) in LIMBS_M.items():
        if not low <= lengths[limb] <= high:
            raise BodyError(
                f"{name}: {limb}",
                expected=f"{low} to {high} m",
                got=f"{lengths[limb]:.2f} m",
                cure="Send a character with a person's proportions, or scale it to its true height in metres.",
            )


def rotations(quaternions: Sequence[object] | np.ndarray, nodes: int) -> np.ndarray:
    """Returns ``quaternions`` as a float64 array (F, N, 4). Raises ``MotionError`` for another number of ``nodes`` N,
    and for quaternions whose length is not one."""
    try:
        turns = np.asarray(quaternions, dtype=np.float64)
    except ValueError:  # Frames differ in length.
        turns = np.zeros(0)
    if turns.ndim != 3 or turns.shape[1:] != (nodes, 4):
        raise MotionError(
            "rig_poses",
            expected=f"{nodes} quaternions a frame, one for each of the avatar's nodes",
            got=f"shape {turns.shape[1:]}" if turns.ndim == 3 else "frames of different lengths",
            cure="GET /avatars/ID tells the nodes in their order.",
        )
    lengths = np.linalg.norm(turns, axis=-1)
    if not (np.abs(lengths - 1.0) <= UNIT_TOLERANCE).all():  # The negation also catches NaN.
        got = f"lengths from {lengths.min():.4g} to {lengths.max():.4g}"
        raise MotionError("rig_poses", expected="unit quaternions xyzw", got=got, cure="Send rotations without scale.")
    return turns


def save_wearer(wearer: Wearer, folder: Path) -> Path:
    """Writes the file of ``wearer`` into ``folder``, whole or not at all. Returns its path."""
    rig, body = wearer.rig, wearer.body
    over = vars(wearer).get("upper", wearer.over)
    over = None if over is body else over
    header = {
        "format_version": FORMAT_VERSION, "name": wearer.name, "digest": wearer.digest, "scale": wearer.scale,
        "height_m": wearer.height_m, "median_mm": wearer.median_mm, "p95_mm": wearer.p95_mm, "vrm": wearer.vrm,
        "nodes": list(wearer.nodes), "rig_names": list(rig.names), "parents": list(rig.parents),
        "told": dict(rig.sources), "body_digest": body.digest, "standard_digest": body.standard_digest,
        "found_by": wearer.found_by, "confidence": wearer.confidence, "notes": list(wearer.notes),
        "bodies": {} if over is None else {UPPER: over.digest},
        "parts": wearer.attire.parts, "skin_colour": wearer.attire.skin_colour,
    }  # fmt: skip
    arrays = {
        "header": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8),
        "vertices": wearer.vertices.astype(np.float32),
        "faces": wearer.faces.astype(np.int32),
        "weights": wearer.weights.astype(np.float32),
        "part": wearer.attire.part.astype(np.int16),
        "colours": np.rint(255.0 * wearer.attire.colours).astype(np.uint8),
        "body_weights": body.weights,
        **_body_arrays("", body),
        **({} if over is None else _body_arrays(f"{UPPER}_", over)),
        "rest_rotations": rig.rest_rotations,
        "rest_translations": rig.rest_translations,
        **({} if wearer.file is None else wearer.file.arrays()),
    }
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / wearer.file_name()
    with whole_file(path) as file:
        file.write(pack(arrays, quick=True))
    return path


def _body_arrays(key: str, body: BodyModel) -> dict[str, np.ndarray]:
    """Arrays from which ``_stored_body`` makes ``body`` again; the weights of all bodies of a wearer are the same."""
    regressor = scipy.sparse.coo_matrix(body.regressor)
    places = np.stack([regressor.row, regressor.col]).astype(np.int32)
    found = {"body_vertices": body.v_template, "regressor_place": places, "regressor_value": regressor.data}
    return {f"{key}{name}": array for name, array in found.items()}


def _stored_body(key: str, digest: str, name: str, arrays: Mapping[str, np.ndarray], body: BodyModel) -> BodyModel:
    shape = (JOINT_COUNT, body.vertex_count)
    held = (arrays[f"{key}{one}"] for one in ("body_vertices", "regressor_value", "regressor_place"))
    vertices, value, place = held
    regressor = scipy.sparse.csr_matrix((value, place), shape)
    return BodyModel(
        name, digest, vertices, np.zeros_like(body.shapedirs), regressor, arrays["body_weights"], body.faces,
        standard_digest=body.digest,
    )  # fmt: skip


def load_wearer(path: Path, body: BodyModel) -> Wearer:
    """Returns the wearer stored at ``path``, for garments of ``body``. Raises ``ArtifactError`` for a damaged file, and
    for one of another version or body."""
    try:
        header, arrays = read_packed(path)
        if header["format_version"] != FORMAT_VERSION or header["standard_digest"] != body.digest:
            raise ValueError("another version, or made for another body")
        worn = _stored_body("", header["body_digest"], header["name"], arrays, body)
        digest = header.get("bodies", {}).get(UPPER)
        over = None if digest is None else _stored_body(f"{UPPER}_", digest, header["name"], arrays, body)
        rig = Rig(
            header["rig_names"], header["parents"], arrays["rest_rotations"], arrays["rest_translations"],
            body.joints_template, header["name"], header["told"],
        )  # fmt: skip
        figures = [header[key] for key in ("scale", "height_m", "median_mm", "p95_mm", "vrm")]
        figures += [header.get("found_by", NAMES), header.get("confidence", 1.0), tuple(header.get("notes", ()))]
        surface = [arrays[key] for key in ("vertices", "faces", "weights")]
        attire = WORN_NOTHING
        if header.get("parts"):
            parts = tuple(AttirePart(*one) for one in header["parts"])
            own = arrays["part"].astype(np.int64)
            colours = arrays.get("colours", np.full((len(own), 3), 160)) / 255.0  # Older files have none.
            attire = Attire(parts, own, tuple(header["skin_colour"]), colours)
        nodes = tuple(header["nodes"])
        return Wearer(
            header["name"], header["digest"], body, worn, rig, nodes, *surface, *figures, attire=attire, over=over
        )
    except (*UNREADABLE, DrapeError) as error:
        raise ArtifactError(
            f"avatar {path.name}", expected="a stored avatar", got=str(error), cure="Send the character again."
        ) from error


def wearer_name(text: str) -> str:
    """Returns ``text`` as an avatar's name: at most 64 lower-case letters, digits and underscores; "avatar" if none."""
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")[:64] or "avatar"


@refusing
def main(arguments: list[str] | None = None) -> int:
    """Reads the character that the command line names, prints its joints, parts and fit, and with ``--out`` stores it.
    Returns the exit status: 0 if the character can wear garments, 2 if it is refused."""
    parser = argparse.ArgumentParser(prog="python -m drape.avatar.wearer", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("file", type=Path, help="GLB or VRM")
    parser.add_argument("--out", type=Path, help="folder of its file; without it nothing is stored")
    given = parser.parse_args(arguments)
    wearer = read_wearer(given.file.read_bytes(), name=wearer_name(given.file.stem))
    for joint, node in wearer.joints.items():
        print(f"{joint:15s} {node}")
    print(f"joints by {wearer.found_by}, {100.0 * wearer.confidence:.0f} % sure")
    for part in wearer.attire.parts:
        print(f"{part.kind:10s} {part.faces:6d} faces, {100.0 * part.sure:3.0f} % sure: {part.name}")
    for note in wearer.notes:
        print(f"note: {note}")
    print(f"height {wearer.height_m:.2f} m; fit {wearer.median_mm:.1f} mm median, {wearer.p95_mm:.1f} mm at 95 %")
    if given.out is not None:
        print(f"stored {save_wearer(wearer, given.out)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
