"""Motion clips from BVH files; every refusal names its line."""

from __future__ import annotations

import codecs
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from drape.errors import MotionError
from drape.motion.clip import MotionClip, check_frame_count
from drape.motion.retarget import SourceSkeleton, euler_to_matrix, global_rotations, retarget

MAX_JOINT_COUNT = 1000

END_SITE = "End Site"

_CHANNELS = {f"{axis}{kind}" for axis in "xyz" for kind in ("position", "rotation")}


@dataclass
class _Joint:
    name: str
    parent: int  # The root has -1.
    offset: list[float] | None = None
    channels: list[str] = field(default_factory=list)


def read_bvh(
    path: Path, *, metres_per_unit: float | None = None, up: str | None = None, most_frames: int | None = None
) -> MotionClip:
    """Returns the clip of a BVH file, retargeted to the 24 SMPL joints, y up, in metres.

    Channels may come in any order; a joint's rotation is the product in that order. ``metres_per_unit`` None guesses
    the unit from the length of the legs; where no unit makes them a person's, the figure walks as far as an adult
    would. ``up`` ("y", "-z", ...) is the file's vertical axis; None finds the one that the person stands along. Raises
    ``MotionError``, which names the line, for a damaged file, and for joints of no person. Raises ``TooLarge``, before
    frames are parsed, if the header declares more than ``most_frames``.
    """
    path = Path(path)
    lines = read_lines(path)
    number, first = lines[0] if lines else (1, "an empty file")
    if not lines or first.split()[0].upper() != "HIERARCHY":
        raise fault(path, number, "HIERARCHY", " ".join(first.split())[:60])
    joints, motion_at = _parse_hierarchy(path, lines)
    frame_count, fps = _parse_motion_header(path, lines[motion_at:])
    check_frame_count(path.name, frame_count, most_frames)
    values = _parse_frames(path, lines[motion_at + 3 :], sum(len(joint.channels) for joint in joints))
    local, places = _local_motion(joints, values)
    skeleton = SourceSkeleton(
        names=tuple(joint.name for joint in joints),
        parents=tuple(joint.parent for joint in joints),
        offsets=np.array([joint.offset for joint in joints]),
    )
    rotations = global_rotations(local, skeleton.parents)
    return retarget(
        skeleton, rotations, places, fps=fps, name=path.stem, metres_per_unit=metres_per_unit, up=up,
        any_size=metres_per_unit is None,
    )  # fmt: skip


def _parse_hierarchy(path: Path, lines: list[Line]) -> tuple[list[_Joint], int]:
    """The joints, parents first, and the index of the line MOTION."""
    joints: list[_Joint] = []
    open_blocks: list[int] = []  # The joint of each open brace.
    announced: list[int] = []  # Joints that are named, and whose brace is not open yet.
    for at, (number, text) in enumerate(lines[1:], 1):
        words = text.split()
        # Some writers open the brace on the line of the name.
        brace_follows = words[-1] == "{" and len(words) > 1
        head, rest = words[0].upper(), words[1 : len(words) - brace_follows]
        if head == "MOTION":
            _check_closed(path, number, joints, open_blocks, announced)
            return joints, at
        if head in ("ROOT", "JOINT", "END"):
            _check_place(path, number, head, joints, open_blocks)
            parent = open_blocks[-1] if open_blocks else -1
            joints.append(_Joint(END_SITE, parent, [0.0] * 3) if head == "END" else _Joint(" ".join(rest), parent))
            announced.append(len(joints) - 1)
        elif head == "}":
            if not open_blocks:
                raise fault(path, number, "as many '{' as '}'", "a '}' too many")
            open_blocks.pop()
        elif head == "OFFSET" and open_blocks:
            joints[open_blocks[-1]].offset = parse_numbers(path, number, rest, count=3, what="OFFSET")
        elif head == "CHANNELS" and open_blocks and joints[open_blocks[-1]].name != END_SITE:
            joints[open_blocks[-1]].channels = _parse_channels(path, number, rest)
        elif head != "{":
            raise fault(
                path, number, "ROOT, JOINT, End Site, OFFSET, CHANNELS, a brace or MOTION", repr(" ".join(words)[:60])
            )
        if head == "{" or brace_follows:
            if not announced:
                raise fault(path, number, "a joint's name before '{'", "none")
            open_blocks.append(announced.pop())
    raise fault(path, lines[-1][0], "a line MOTION", "the end of the file", "The file is cut off; fetch it again.")


def _check_place(path: Path, number: int, head: str, joints: list[_Joint], open_blocks: list[int]) -> None:
    if head == "ROOT" and joints:
        raise fault(path, number, "one ROOT", "a second", "Export one skeleton per file.")
    if head != "ROOT" and (not open_blocks or joints[open_blocks[-1]].name == END_SITE):
        raise fault(path, number, f"{head} inside a joint's braces", "none open")
    if len(joints) >= MAX_JOINT_COUNT:
        raise fault(path, number, f"at most {MAX_JOINT_COUNT} joints", "more")


def _check_closed(path: Path, number: int, joints: list[_Joint], open_blocks: list, announced: list) -> None:
    if open_blocks or announced:
        raise fault(path, number, "every '{' closed before MOTION", f"{len(open_blocks) + len(announced)} open")
    if not joints:
        raise fault(path, number, "a ROOT", "none")
    for joint in joints:
        if joint.offset is None:
            raise fault(path, number, f"an OFFSET of joint {joint.name!r}", "none")


def _parse_channels(path: Path, number: int, words: list[str]) -> list[str]:
    if not words or not words[0].isdigit() or int(words[0]) != len(words) - 1:
        raise fault(path, number, "CHANNELS, their count and as many names", repr(" ".join(words)[:60]))
    channels = [word.lower() for word in words[1:]]
    if not set(channels) <= _CHANNELS or len(set(channels)) != len(channels):
        raise fault(path, number, "distinct channels such as Xposition or Zrotation", repr(" ".join(words[1:])[:60]))
    return channels


def _parse_motion_header(path: Path, lines: list[Line]) -> tuple[int, float]:
    """The number of frames, which the ``lines`` from MOTION on hold too, and their rate [1/s]."""
    header = {}
    for (number, text), key in zip(lines[1:3], ("Frames:", "Frame Time:"), strict=False):
        words = text.split()
        if " ".join(words[: key.count(" ") + 1]).lower() != key.lower():
            raise fault(path, number, f"{key!r} and a number", repr(" ".join(words)[:60]))
        header[key] = parse_numbers(path, number, words[key.count(" ") + 1 :], count=1, what=key)[0], number
    if len(header) < 2:
        raise fault(path, lines[-1][0], "'Frames:' and 'Frame Time:' after MOTION", "the end of the file")
    (frame_count, count_line), (frame_time, time_line) = header.values()
    if frame_time <= 0.0:
        raise fault(path, time_line, "a positive frame time [s]", str(frame_time))
    rows = lines[3:]
    if frame_count < 1 or frame_count != len(rows):
        last = rows[-1][0] if rows else count_line
        raise fault(
            path,
            last,
            f"{frame_count:g} frames, as declared (1 or more)",
            f"{len(rows)}",
            "The file is cut off or its count is wrong.",
        )
    return int(frame_count), 1.0 / frame_time


def _parse_frames(path: Path, rows: list[Line], channel_count: int) -> np.ndarray:
    """The values (F, channels) of the frames in ``rows``."""
    # One at a time: words and numbers of all would take ten times the file.
    return np.array(
        [np.array(parse_numbers(path, number, text.split(), count=channel_count, what="a frame"))
         for number, text in rows]
    )  # fmt: skip


def _local_motion(joints: list[_Joint], values: np.ndarray) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """Rotations relative to the parent (F, J, 3, 3), and the positions (F, 3) of the joints that move."""
    local = np.empty((len(values), len(joints), 3, 3))
    places = {}
    column = 0
    for index, joint in enumerate(joints):
        block = values[:, column : column + len(joint.channels)]
        column += len(joint.channels)
        turns = [i for i, channel in enumerate(joint.channels) if channel.endswith("rotation")]
        local[:, index] = euler_to_matrix(
            np.radians(block[:, turns]), "".join(joint.channels[i][0].upper() for i in turns)
        )
        moves = {"xyz".index(channel[0]): i for i, channel in enumerate(joint.channels) if channel.endswith("position")}
        if moves or index == 0:
            # A position channel replaces the offset on its axis.
            places[index] = np.tile(np.array(joint.offset), (len(values), 1))
            places[index][:, list(moves)] = block[:, list(moves.values())]
    return local, places


MAX_FILE_BYTES = 128 << 20
"""Largest text file [bytes] that is read: about 20 minutes of BVH at 120 Hz."""

Line = tuple[int, str]
"""A line's number, from 1, and its text."""


def read_lines(path: Path) -> list[Line]:
    """Returns the lines of a text file that are not empty, each as its number, from 1, and its text. Comments after
    ``#`` are dropped. Raises ``MotionError`` for a file that cannot be read or is too large."""
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise MotionError(
                path.name,
                expected=f"at most {MAX_FILE_BYTES} bytes",
                got=str(size),
                cure="Cut the clip into shorter files.",
            )
        text = _decoded(path.read_bytes())
    except OSError as cause:
        raise MotionError(path.name, expected="a readable file", got=str(cause), cure="Check the path.") from cause
    cut = ((number, line.split("#", 1)[0].strip()) for number, line in enumerate(text.splitlines(), 1))
    return [(number, line) for number, line in cut if line]


def _decoded(payload: bytes) -> str:
    """The text of a file in UTF-8, with or without a mark of byte order, in UTF-16 or in Latin-1, which decodes any
    bytes."""
    if payload[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return payload.decode("utf-16", errors="replace")
    try:
        return payload.decode("utf-8-sig")
    except UnicodeDecodeError:
        return payload.decode("latin-1")


def fault(path: Path, number: int, expected: str, got: str, cure: str = "Export the file again.") -> MotionError:
    """Returns a refusal that names the file and the line ``number``."""
    return MotionError(f"{Path(path).name}, line {number}", expected=expected, got=got, cure=cure)


def parse_numbers(path: Path, number: int, words: Sequence[str], *, count: int, what: str) -> list[float]:
    """Returns the ``count`` finite numbers in ``words``, those of line ``number``. Raises ``MotionError`` for any other
    words; ``what`` says there what the numbers are."""
    if len(words) != count:
        raise fault(path, number, f"{count} numbers for {what}", str(len(words)))
    try:
        values = [float(word) for word in words]
    except ValueError as cause:
        raise fault(path, number, f"numbers for {what}", repr(" ".join(words)[:60])) from cause
    if not all(math.isfinite(value) for value in values):
        raise fault(
            path, number, f"finite numbers for {what}", repr(" ".join(words)[:60]), "Repair or cut the broken frames."
        )
    return values
