"""Drapes garments on moving bodies in a program, without a service.

    import drape

    d = drape.load()
    shirt = d.wear("tshirt", fabric="denim")
    for frame in shirt.play("walk"):
        print(frame.time_s, frame.vertices.shape)

The frames equal the service's to the bit, because the same stages compute them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from drape.avatar.covered import UNSEEN_M, covered_faces
from drape.avatar.file_skeleton import FileRig
from drape.avatar.own_clothes import NEITHER, Halves, joined_halves
from drape.avatar.own_garments import OwnGarments, body_of, halves_on, own_faces, own_garments, split_own, undress
from drape.avatar.rig_file import Dressed
from drape.avatar.rig_motion import RigClip
from drape.avatar.wearer import Wearer, read_wearer, wearer_name
from drape.avatar.wears import reach_of, why_not
from drape.avatar.worn_file import undressed_file, worn_on_rig
from drape.body.assets import DEFAULT_BODY, load_body
from drape.body.model import BodyModel
from drape.body.pose_distance import PoseSupport
from drape.catalog import GARMENTS_DIR, MOTIONS_DIR, find_garments, find_motions, open_outfit, short_name
from drape.cloth.fabric_table import FABRICS
from drape.errors import InputError
from drape.export.glb import GARMENT_COLOURS
from drape.export.surface import by_layer
from drape.folders import ASSETS
from drape.garment.bound import BoundMesh
from drape.garment.cache import Garment
from drape.garment.tailor import tailored
from drape.graph.layer_feed import check_layers
from drape.inference.engine import Engine
from drape.live.card_lanes import open_lanes
from drape.motion.clip import MotionClip
from drape.motion.grounding import place_on_ground
from drape.motion.readers import read_motion
from drape.runtime import Runtime
from drape.stages.batch import Batch, Memories, PoseInput, motion_arrays, shape_array
from drape.stages.body_stages import BodyStages
from drape.stages.plan import Plan
from drape.stages.scene import Entry, Outfit, Scene
from drape.stages.sizes import SizeChoice, Sizes
from drape.stages.walk import run
from drape.wire.options import Advanced, DrapeOptions, Inertia, TierName

MODEL = "onefit"
CHUNK_FRAMES = 8  # Frames that are computed together. The numbers do not depend on it.
MOST_FRAMES = 1 << 20


@dataclass(frozen=True)
class Defaults:
    """The values of options that a caller leaves open, equal to the service's."""

    tier: TierName = "balanced"
    folds: int | None = None
    inertia: Inertia = "mesh"


@dataclass(frozen=True, eq=False)
class Frame:
    """One draped frame of a motion.

    ``time_s`` is its time [s]. ``vertices`` [m] (V, 3), float32, are those of all visible garments, one garment after
    the other, in the world. ``novelty`` says how unlike the poses of training this pose is: above 1 it is unlike them.
    ``pushed_share`` in [0, 1] is the share of the vertices that were moved off the skin.
    """

    time_s: float
    vertices: np.ndarray
    novelty: float
    pushed_share: float


def load(model: str | Path = MODEL, body: str | Path = DEFAULT_BODY) -> Drape:
    """Returns a model with the body that it drapes garments on. Without arguments these are the shipped ones.

    ``model``: the name of a shipped model, or the folder of another. ``body``: the name of a shipped body, or the file
    of another. Raises ``NotFound`` for a name that does not exist, and ``ArtifactError`` if a file is damaged, or if
    the model was trained on another body.
    """
    folder = Path(model)
    engine = Engine(folder if folder.is_dir() else ASSETS / "models" / str(model))
    return Drape(Runtime(engine, load_body(str(body)), Defaults(), lane=open_lanes()))


class Drape:
    """A model and the body that it drapes garments on. ``load`` returns one."""

    def __init__(self, runtime: Runtime) -> None:
        self._runtime = runtime
        self._characters: dict[Path, Wearer] = {}
        self._own: dict[Path, OwnGarments] = {}
        self._stages: dict[str, BodyStages] = {}  # Keys are digests of bodies.

    @property
    def body(self) -> BodyModel:
        """The body that garments are draped on."""
        return self._runtime.body

    @property
    def garments(self) -> list[str]:
        """The sorted names of the shipped garments."""
        return sorted(short_name(path) for path in GARMENTS_DIR.glob("*.npz"))

    @property
    def motions(self) -> list[str]:
        """The sorted names of the shipped clips."""
        return sorted(path.stem for path in MOTIONS_DIR.glob("*.npz"))

    @property
    def fabrics(self) -> list[str]:
        """The sorted names of the fabrics."""
        return sorted(FABRICS)

    def wear(
        self,
        garments: str | Path | Garment | Sequence[str | Path | Garment] = (),
        *,
        on: str | Path | None = None,
        alive: bool = False,
        betas: Sequence[float] | None = None,
        size: SizeChoice = None,
        **options: Any,
    ) -> Worn:
        """Returns ``garments`` on the body, ready to be draped.

        ``garments``: one garment, or several worn over each other, the innermost first. Each is a shipped name, a file
        (a mesh of one garment or several, or a stored garment), or a ``Garment`` that ``drape.intake`` made. ``on``:
        the GLB or VRM file of a character that wears them in place of the body. ``alive``: the character's own clothes
        are draped as well, but for those that ``garments`` replace; it takes seconds. ``betas``: the body's shape
        coefficients; a character has none. ``size``: "S", "M", "L" or "XL" of all garments, or a list with one for each
        garment, None where it comes in one size; a size takes seconds. ``options`` are the fields of ``DrapeOptions``,
        such as ``tier``, ``fabric``, ``hidden`` and ``colliders``.

        Raises ``InputError`` for an unknown option or a value out of range, ``NotFound`` for an unknown name or size,
        and ``BodyError`` for a character that cannot wear one of them.
        """
        choices = [garments] if isinstance(garments, (str, Path, Garment)) else list(garments)
        wearer = None if on is None else self._character(Path(on))
        entries = tuple(entry for choice in choices for entry in self._entries(choice))
        if alive and on is None:
            cure = "Name the file of a character: on=FILE."
            raise InputError("alive", expected="a character", got="the standard body", cure=cure)
        own = self._own_garments(Path(on)) if alive and on is not None else ()
        if not entries and not own and on is not None and alive:
            stiff = "; ".join(f"{name}: {why}" for name, why in self._own[Path(on)].stiff.items())
            raise InputError("alive", expected="clothes that are cloth", got=stiff or "none", cure="Name a garment.")
        if not entries and not own:
            raise InputError("garments", expected="one or more", got="none", cure="Name a garment.")
        if size is not None:
            entries = Sizes(self.body, GARMENTS_DIR, entries).wear(Outfit(entries), size).layers
        body, halves = self.body, NEITHER
        if wearer is not None:
            halves = self._halves_on(wearer, entries)
            below, over = split_own(own, halves)
            entries = (*map(_entry, below), *entries, *map(_entry, over))
            body = wearer.body_under(halves_on(wearer, [entry.garment for entry in entries], self.body))
            stages = self._stages_of(body)
            cut = [
                tailored(entry.garment, body_of(entry.garment, wearer, self.body), body, shoes_m=wearer.shoes_m)
                for entry in entries
            ]
            entries = tuple(replace(entry, garment=its, worn=stages) for entry, its in zip(entries, cut, strict=True))
        if len(entries) > 1:
            check_layers([entry.garment for entry in entries])
        scene: Scene = entries[0] if len(entries) == 1 else Outfit(entries)
        shape = shape_array(betas, body)
        worn_by = None if wearer is None or on is None else WornBy(wearer, Path(on), halves)
        return Worn(self._runtime, scene, _checked(options), body, shape, worn_by)

    def _halves_on(self, wearer: Wearer, entries: Sequence[Entry]) -> Halves:
        """The halves of ``wearer`` on which ``entries`` lie; refuses what it cannot wear."""
        reaches = [reach_of(one.garment, self.body) for one in entries]
        for one, reach in zip(entries, reaches, strict=True):
            if (refusal := why_not(wearer.body, reach, garment=one.id)) is not None:
                raise refusal
        return joined_halves([reach.halves for reach in reaches])

    def _stages_of(self, body: BodyModel) -> BodyStages:
        if body.digest not in self._stages:
            self._stages[body.digest] = self._runtime.stages_on(body)
        return self._stages[body.digest]

    def _character(self, path: Path) -> Wearer:
        if path not in self._characters:
            try:
                payload = path.read_bytes()
            except OSError as error:
                raise InputError(
                    "on", expected="a GLB or VRM file", got=f"{path}: {error.strerror}", cure="Check the path."
                ) from error
            self._characters[path] = read_wearer(payload, name=wearer_name(path.stem), body=self.body)
        return self._characters[path]

    def _own_garments(self, path: Path) -> tuple[Garment, ...]:
        if path not in self._own:
            self._own[path] = own_garments(path.read_bytes(), self._character(path))
        return self._own[path].garments

    def _entries(self, choice: str | Path | Garment) -> list[Entry]:
        if isinstance(choice, Garment):
            return [_entry(choice)]
        return list(map(_entry, open_outfit(find_garments([str(choice)])[0], self.body)))


class WornBy(NamedTuple):
    """The character that wears garments, its ``file``, and on which ``halves`` of its body, the upper and the lower
    one, garments lie that are not its own."""

    wearer: Wearer
    file: Path
    halves: Halves


class Worn:
    """Garments on a body, as ``Drape.wear`` returns them. ``play`` drapes a clip, ``pose`` one pose after the other."""

    def __init__(
        self,
        runtime: Runtime,
        scene: Scene,
        options: DrapeOptions,
        body: BodyModel,
        betas: np.ndarray,
        worn_by: WornBy | None = None,
    ) -> None:
        self._runtime, self._betas, self._worn_by, self.body = runtime, betas, worn_by, body
        self._plan: Plan = runtime.plan(scene, options)
        runtime.ready(self._plan)
        self._memories: Memories = {}

    @property
    def garments(self) -> list[Garment | BoundMesh]:
        """The meshes of the visible garments that are drawn, the innermost first. Each has its ``faces`` (F, 3) and its
        ``vertex_count``."""
        return [garment.surface for garment in self.layers]

    @property
    def wearer(self) -> Wearer | None:
        """The character that wears them; None for the standard body."""
        return None if self._worn_by is None else self._worn_by.wearer

    @property
    def layers(self) -> list[Garment]:
        """The visible garments, the innermost first, with their patches and all else that intake found."""
        return [entry.garment for entry in self._plan.shown.layers]

    @cached_property
    def character_file(self) -> bytes:
        """The bytes of the character's file without the faces that the garments replace and those that lie deep below
        them, and with skin where it is bare then.

        Raises ``InputError`` for garments on the standard body.
        """
        wearer, rig = self.on_rig()
        assert self._worn_by is not None
        cloth = [(one.vertices, one.faces) for one in self.layers]
        left = undress(wearer, own_faces(wearer, self.layers), cloth, self._worn_by.halves)
        own = covered_faces(wearer.vertices, wearer.faces, cloth, margin_m=UNSEEN_M)
        skin = covered_faces(wearer.body.v_template, wearer.body.faces, cloth, margin_m=UNSEEN_M)
        left = left._replace(off=left.off | own, bare=left.bare & ~skin, deep=None)  # Players draw nothing deeper.
        return undressed_file(self._worn_by.file.read_bytes(), wearer, rig, left)

    def glb(
        self, motion: str | Path | MotionClip, *, fps: float = 30.0, as_recorded: bool = False, quantised: bool = True
    ) -> bytes:
        """Returns the bytes of the character's file with the garments in it and an animation of ``motion``, which
        ``placed`` describes. Each garment has a morph target for each frame, which is its drape, in 16 bytes a vertex.
        ``drape.distil`` makes smaller files. ``quantised``: normals have 8 bits; otherwise all is float32, 24 bytes.

        Raises ``InputError`` for garments on the standard body.
        """
        wearer, rig = self.on_rig()
        clip = self.placed(motion, fps=fps, as_recorded=as_recorded)
        vertices = np.stack([frame.vertices for frame in self.play(clip, fps=clip.fps, as_recorded=True)])
        layers = map(Dressed, self.layers, by_layer(self.garments, vertices), itertools.cycle(GARMENT_COLOURS))
        on_rig = RigClip(*wearer.to_rig(clip.poses, clip.trans), clip.fps)
        return worn_on_rig(self.character_file, list(layers), on_rig, wearer, rig, quantised=quantised).to_bytes()

    def on_rig(self) -> tuple[Wearer, FileRig]:
        """Returns the character and the rig of its file. Raises ``InputError`` for garments on the standard body."""
        if self.wearer is None or self.wearer.file is None:
            cure = "Name the file of a character: wear(..., on=FILE)."
            expected, got = "garments on a character, which has a rig", "the standard body"
            raise InputError("character", expected=expected, got=got, cure=cure)
        return self.wearer, self.wearer.file

    @property
    def pose_support(self) -> PoseSupport | None:
        """The poses of training that the model keeps; None where it keeps none."""
        return self._runtime.engine.pose_support

    @property
    def tier(self) -> str:
        """The name of the tier that is computed, or "custom" if the options are those of no tier."""
        return self._runtime.tier_of(self._plan)

    def placed(self, motion: str | Path | MotionClip, *, fps: float = 30.0, as_recorded: bool = False) -> MotionClip:
        """Returns ``motion`` as a clip of ``fps`` frames a second.

        ``motion``: a shipped name, a file (``read_motion``), or a clip. The soles of the body are put on the ground y =
        0, unless ``as_recorded`` leaves the translations as they are. Raises ``NotFound`` for an unknown name and
        ``MotionError`` for a file that cannot be read.
        """
        clip = motion if isinstance(motion, MotionClip) else read_motion(find_motions([str(motion)])[0])
        if not as_recorded:
            clip = place_on_ground(clip, self.body.rest_joints(self._betas), floor=self.body.floor_m(self._betas))
        return clip if clip.fps == fps else clip.resampled(fps)

    def play(self, motion: str | Path | MotionClip, *, fps: float = 30.0, as_recorded: bool = False) -> Iterator[Frame]:
        """Yields the draped frames of ``motion``, which ``placed`` describes. The first frame is cloth at rest,
        whatever ``pose`` has draped before."""
        clip = self.placed(motion, fps=fps, as_recorded=as_recorded)
        poses, trans = motion_arrays(clip.poses, clip.trans, max_frames=MOST_FRAMES)
        whole = PoseInput(poses, trans, self._betas, np.arange(len(poses)) / clip.fps)
        memories: Memories = {}
        for start in range(0, len(poses), CHUNK_FRAMES):
            part = whole.part(slice(start, start + CHUNK_FRAMES), memories)
            batch = run(self._plan, [part])
            memories = batch.memories[0]
            yield from _frames(batch, part)

    def pose(self, pose: np.ndarray, trans: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0), *, time_s: float) -> Frame:
        """Returns the draped frame of one SMPL ``pose`` (24, 3) [rad], with the root displaced by ``trans`` [m] (3,).

        ``time_s`` [s] is the pose's time on a clock that only goes forward. The cloth goes on from the frame before;
        after ``restart`` it begins at rest. Raises ``MotionError`` for an array that is no pose.
        """
        poses, places = motion_arrays(np.asarray(pose)[None], np.asarray(trans)[None], max_frames=1)
        part = PoseInput(poses, places, self._betas, np.array([float(time_s)]), self._memories)
        batch = run(self._plan, [part])
        self._memories = batch.memories[0]
        (frame,) = _frames(batch, part)
        return frame

    def restart(self) -> None:
        """Forgets the frames so far: the next ``pose`` begins from cloth at rest."""
        self._memories = {}


def _entry(garment: Garment) -> Entry:
    return Entry(garment.name, garment, "user")


def _frames(batch: Batch, part: PoseInput) -> Iterator[Frame]:
    world, quality = batch.world(), batch.quality
    for row, time_s in enumerate(part.times_s.tolist()):
        yield Frame(time_s, world[row], float(quality.novelty[row]), float(quality.pushed_share[row]))


def _checked(options: dict[str, Any]) -> DrapeOptions:
    """The ``options`` by name; refuses (``InputError``) the first that is none or has no such value."""
    known = [name for name in DrapeOptions.model_fields if name != "geometry"]
    for name in options:
        if name not in (*known, *Advanced.model_fields):
            cure = "help(drape.DrapeOptions) has them."
            raise InputError("options", expected=f"some of: {', '.join(known)}", got=name, cure=cure)
    try:
        return DrapeOptions(**options)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(map(str, first["loc"][: 2 if first["loc"][0] == "advanced" else 1]))
        expected = first["msg"].removeprefix("Input should be ")
        raise InputError(
            name, expected=expected, got=repr(first["input"])[:120], cure="help(drape.DrapeOptions)."
        ) from error
