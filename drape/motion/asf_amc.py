"""Motion clips from Acclaim files: a skeleton (ASF) and its motion (AMC)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from drape.errors import MotionError
from drape.motion.clip import MotionClip
from drape.motion.retarget import SourceSkeleton, euler_to_matrix, global_rotations, retarget
from drape.motion.text import fault, parse_numbers, read_lines

CMU_FPS = 120.0
"""AMC files do not state their rate; CMU's are 120 Hz."""

_DOFS = ("tx", "ty", "tz", "rx", "ry", "rz", "l")


@dataclass
class _Bone:
    name: str
    direction: list[float] = field(default_factory=list)
    length: float = math.nan
    axis: np.ndarray = field(default_factory=lambda: np.eye(3))
    dof: list[str] = field(default_factory=list)


@dataclass
class _Skeleton:
    length_unit: float = 1.0
    degrees: bool = True
    root_order: list[str] = field(default_factory=lambda: ["tx", "ty", "tz", "rx", "ry", "rz"])
    root_axis: str = "XYZ"
    root_position: np.ndarray = field(default_factory=lambda: np.zeros(3))
    root_orientation: np.ndarray = field(default_factory=lambda: np.zeros(3))
    bones: dict[str, _Bone] = field(default_factory=dict)
    parents: dict[str, str] = field(default_factory=dict)


def read_amc(
    path: Path, *, asf: Path | None = None, fps: float = CMU_FPS, metres_per_unit: float | None = None
) -> MotionClip:
    """The clip of an AMC file, retargeted to the 24 SMPL joints.

    Without ``asf`` the skeleton is the one beside the file: ``02.asf`` for
    ``02_01.amc``, or the folder's only one. Lengths are ``1 / length`` inches,
    ``length`` being the ASF's unit (CMU: 0.45), unless ``metres_per_unit`` says otherwise.
    """
    path = Path(path)
    asf = find_asf(path) if asf is None else Path(asf)
    skeleton = _parse_asf(asf)
    order = _parent_first(asf, skeleton)
    frames = _parse_amc(path, skeleton)
    local, root = _local_motion(skeleton, order, frames)
    indices = {name: index for index, name in enumerate(order)}
    parents = tuple(-1 if name == "root" else indices[skeleton.parents[name]] for name in order)
    source = SourceSkeleton(names=tuple(order), parents=parents, offsets=_offsets(skeleton, order))
    scale = 0.0254 / skeleton.length_unit if metres_per_unit is None else metres_per_unit
    rotations = global_rotations(local, parents)
    return retarget(source, rotations, {0: root}, fps=fps, name=path.stem, metres_per_unit=scale)


def find_asf(path: Path) -> Path:
    """The ASF file that belongs to an AMC file."""
    candidates = sorted(file for file in path.parent.glob("*") if file.suffix.lower() == ".asf")
    named = [file for file in candidates if file.stem in (path.stem, path.stem.split("_")[0])]
    if len(named) == 1 or len(candidates) == 1:
        return (named or candidates)[0]
    raise MotionError(
        path.name,
        expected=f"a skeleton {path.stem.split('_')[0]}.asf beside it",
        got=f"{len(candidates)} other ASF files" if candidates else "no ASF file",
        cure="Put the skeleton of this subject into the same folder.",
    )


def _parse_asf(path: Path) -> _Skeleton:
    skeleton = _Skeleton()
    section, bone = "", None
    lines = read_lines(path)
    for number, words in lines:
        if words[0].startswith(":"):
            section = words[0].lower()
        elif section == ":units":
            _parse_unit(path, number, words, skeleton)
        elif section == ":root":
            _parse_root(path, number, words, skeleton)
        elif section == ":bonedata":
            bone = _parse_bone(path, number, words, skeleton, bone)
        elif section == ":hierarchy" and words[0].lower() not in ("begin", "end"):
            _parse_children(path, number, words, skeleton)
    last = lines[-1][0] if lines else 1
    if bone is not None:
        raise fault(
            path, last, f"'end' of bone {bone.name!r}", "the end of the file", "The file is cut off; fetch it again."
        )
    if not skeleton.bones or not skeleton.parents:
        raise fault(
            path, last, "sections :bonedata and :hierarchy", "the end of the file", "The file is cut off or no ASF."
        )
    return skeleton


def _parse_unit(path: Path, number: int, words: list[str], skeleton: _Skeleton) -> None:
    if words[0].lower() == "length":
        skeleton.length_unit = parse_numbers(path, number, words[1:], count=1, what="the unit of length")[0]
        if skeleton.length_unit <= 0.0:
            raise fault(path, number, "a positive unit of length", str(skeleton.length_unit))
    elif words[0].lower() == "angle":
        skeleton.degrees = _is_degrees(path, number, words[-1])


def _is_degrees(path: Path, number: int, word: str) -> bool:
    if word.lower() not in ("deg", "degrees", "rad", "radians"):
        raise fault(path, number, "angles in deg or rad", repr(word))
    return word.lower().startswith("deg")


def _parse_root(path: Path, number: int, words: list[str], skeleton: _Skeleton) -> None:
    key, rest = words[0].lower(), words[1:]
    if key == "order":
        skeleton.root_order = _parse_dofs(path, number, rest)
    elif key == "axis":
        skeleton.root_axis = _parse_axes(path, number, rest)
    elif key == "position":
        skeleton.root_position = np.array(parse_numbers(path, number, rest, count=3, what="the root's position"))
    elif key == "orientation":
        skeleton.root_orientation = np.array(parse_numbers(path, number, rest, count=3, what="the root's orientation"))


def _parse_dofs(path: Path, number: int, words: list[str]) -> list[str]:
    dofs = [word.lower() for word in words]
    if not set(dofs) <= set(_DOFS) or len(set(dofs)) != len(dofs):
        raise fault(path, number, "distinct degrees of freedom among tx ty tz rx ry rz l", repr(" ".join(words)))
    return dofs


def _parse_axes(path: Path, number: int, words: list[str]) -> str:
    if len(words) != 1 or sorted(words[0].upper()) != ["X", "Y", "Z"]:
        raise fault(path, number, "an order of axes such as XYZ", repr(" ".join(words)))
    return words[0].upper()


def _parse_bone(path: Path, number: int, words: list[str], skeleton: _Skeleton, bone: _Bone | None) -> _Bone | None:
    """The bone that is open after this line of :bonedata."""
    key, rest = words[0].lower(), words[1:]
    if key == "begin":
        if bone is not None:
            raise fault(path, number, "'end' before the next 'begin'", "none")
        return _Bone("")
    if bone is None:
        raise fault(path, number, "'begin'", repr(" ".join(words)[:60]))
    if key == "end":
        if not bone.name or not bone.direction or math.isnan(bone.length):
            raise fault(path, number, "name, direction and length of the bone", f"none for {bone.name!r}")
        if bone.name in skeleton.bones or bone.name == "root":
            raise fault(path, number, "a new name for each bone, other than root", repr(bone.name))
        skeleton.bones[bone.name] = bone
        return None
    if key == "name":
        bone.name = " ".join(rest)
    elif key == "direction":
        bone.direction = parse_numbers(path, number, rest, count=3, what="direction")
    elif key == "length":
        bone.length = parse_numbers(path, number, rest, count=1, what="length")[0]
    elif key == "dof":
        bone.dof = _parse_dofs(path, number, rest)
    elif key == "axis":
        angles = np.array(parse_numbers(path, number, rest[:3], count=3, what="axis"))
        bone.axis = _fixed_axes_matrix(_radians(angles, skeleton.degrees), _parse_axes(path, number, rest[3:]))
    return bone


def _parse_children(path: Path, number: int, words: list[str], skeleton: _Skeleton) -> None:
    parent, *children = words
    for name in words:
        if name != "root" and name not in skeleton.bones:
            raise fault(path, number, "bones of :bonedata", repr(name))
    for child in children:
        if child in skeleton.parents or child == "root":
            raise fault(path, number, "one parent per bone", f"a second for {child!r}")
        skeleton.parents[child] = parent


def _parent_first(path: Path, skeleton: _Skeleton) -> list[str]:
    order = ["root"]
    for name in order:
        order.extend(child for child, parent in skeleton.parents.items() if parent == name)
    lost = (set(skeleton.parents) | set(skeleton.bones)) - set(order)
    if lost:
        raise MotionError(
            path.name,
            expected="every bone below root in :hierarchy",
            got=f"{sorted(lost)[:5]} apart",
            cure="Export the skeleton again.",
        )
    return order


def _parse_amc(path: Path, skeleton: _Skeleton) -> list[dict[str, np.ndarray]]:
    """Per frame, each bone's values: lengths in the file's unit, angles [rad]."""
    sizes = {"root": len(skeleton.root_order)} | {
        name: len(bone.dof) for name, bone in skeleton.bones.items() if bone.dof
    }
    dofs = {"root": skeleton.root_order} | {name: bone.dof for name, bone in skeleton.bones.items()}
    is_angle = {name: np.array([dof.startswith("r") for dof in dofs[name]]) for name in sizes}
    degrees = skeleton.degrees
    frames: list[dict[str, np.ndarray]] = []
    lines = read_lines(path)
    for number, words in lines:
        if words[0].startswith(":"):
            if words[0].lower() in (":degrees", ":radians"):
                degrees = _is_degrees(path, number, words[0][1:])
        elif len(words) == 1 and words[0].isdigit():
            _check_frame(path, number, frames, sizes)
            frames.append({})
        else:
            name = words[0]
            if not frames or name not in sizes or name in frames[-1]:
                raise fault(
                    path, number, "a frame number, then each bone of the skeleton once", repr(" ".join(words)[:60])
                )
            values = np.array(parse_numbers(path, number, words[1:], count=sizes[name], what=name))
            frames[-1][name] = np.where(is_angle[name], _radians(values, degrees), values)
    last = lines[-1][0] if lines else 1
    if not frames:
        raise fault(path, last, "frames", "none", "The file is cut off or no AMC.")
    _check_frame(path, last, frames, sizes)
    return frames


def _check_frame(path: Path, number: int, frames: list[dict[str, np.ndarray]], sizes: dict[str, int]) -> None:
    if frames and len(frames[-1]) != len(sizes):
        missing = sorted(set(sizes) - set(frames[-1]))[:5]
        raise fault(
            path,
            number,
            f"every bone in frame {len(frames)}",
            f"no {', '.join(missing)}",
            "The file is cut off; fetch it again.",
        )


def _local_motion(
    skeleton: _Skeleton, order: list[str], frames: list[dict[str, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """Rotations relative to the parent (F, J, 3, 3), the rest pose being all identity; root positions (F, 3)."""
    local = np.empty((len(frames), len(order), 3, 3))
    root_values = np.stack([frame["root"] for frame in frames])
    root = np.tile(skeleton.root_position, (len(frames), 1))
    for column, dof in enumerate(skeleton.root_order):
        if dof.startswith("t"):
            root[:, "xyz".index(dof[1])] += root_values[:, column]
    for joint, name in enumerate(order):
        if name == "root":
            base = _fixed_axes_matrix(_radians(skeleton.root_orientation, skeleton.degrees), skeleton.root_axis)
            local[:, 0] = base @ _dof_matrix(root_values, skeleton.root_order)
            continue
        bone = skeleton.bones[name]
        if not bone.dof:
            local[:, joint] = np.eye(3)
            continue
        values = np.stack([frame[name] for frame in frames])
        local[:, joint] = bone.axis @ _dof_matrix(values, bone.dof) @ bone.axis.T
    return local, root


def _offsets(skeleton: _Skeleton, order: list[str]) -> np.ndarray:
    """Offsets (J, 3) of each bone's start from its parent's start: the parent's direction times its length."""
    offsets = np.zeros((len(order), 3))
    for joint, name in enumerate(order):
        parent = skeleton.parents.get(name, "root")
        if name != "root" and parent != "root":
            direction = np.array(skeleton.bones[parent].direction)
            offsets[joint] = direction / max(np.linalg.norm(direction), 1e-12) * skeleton.bones[parent].length
    return offsets


def _dof_matrix(values: np.ndarray, dofs: list[str]) -> np.ndarray:
    turns = [column for column, dof in enumerate(dofs) if dof.startswith("r")]
    return _fixed_axes_matrix(values[:, turns], "".join(dofs[column][1].upper() for column in turns))


def _fixed_axes_matrix(angles_rad: np.ndarray, axes: str) -> np.ndarray:
    """Acclaim turns about fixed axes, the first named first."""
    return euler_to_matrix(angles_rad[..., ::-1], axes[::-1])


def _radians(values: np.ndarray, degrees: bool) -> np.ndarray:
    return np.radians(values) if degrees else values
