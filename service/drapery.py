"""Poses in, draped vertices out: features, graphs and push-out, on one worker thread."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Literal, TypeVar

import numpy as np

from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.errors import InputError, NotFound
from drape.geometry import jets
from drape.graph.feeds import BodyFeed, body_feed, kinematics
from drape.graph.packing import pack_body
from service.dynamics import Memory, Moment, advance, nothing
from service.engine import JETS, SKIN, Engine, check_finite
from service.garments import Entry, Outfit, Registry, Scene
from service.motions import Motions
from service.packing import OUTPUTS_OF, Packer, ScenePlan, Shape
from service.push import MOVED_M, PosedJets, PushedJets, Pusher
from service.settings import Settings

Result = TypeVar("Result")
Geometry = Literal["vertices", "jets"]


@dataclass(frozen=True, eq=False)
class PoseInput:
    """Checked poses (F, 24, 3), translations (F, 3) and one shape (S,), and whether to push out.

    ``passes``: how many corrections of the network run, None for all; the same for all inputs of a call.

    With a ``motion`` knob above 0 the cloth follows the motion: ``times_s`` (F,) says when each frame is,
    ``memory`` what came before the first.
    """

    poses: np.ndarray
    trans: np.ndarray
    betas: np.ndarray
    push: bool
    motion: float = 0.0
    times_s: np.ndarray | None = None
    memory: Memory | None = None
    passes: int | None = None

    def part(self, rows: slice, memory: Memory | None) -> PoseInput:
        """The frames ``rows``, after what ``memory`` holds."""
        times = None if self.times_s is None else self.times_s[rows]
        return replace(self, poses=self.poses[rows], trans=self.trans[rows], times_s=times, memory=memory)


@dataclass(frozen=True, eq=False)
class Draped:
    """Vertices [m] (F, V, 3) float32 relative to ``root`` [m] (F, 3) float64, and what the push-out did.

    ``pushed_share`` (F,) is the share of vertices that the push-out moved, ``push_max_m`` (F,) the furthest.
    ``memories``: what each input's body leaves behind, None where its motion does not count.
    """

    vertices: np.ndarray
    root: np.ndarray
    pushed: bool
    pushed_share: np.ndarray
    push_max_m: np.ndarray
    memories: tuple[Memory | None, ...]

    def world(self) -> np.ndarray:
        """World positions [m] (F, V, 3) float32."""
        return (self.vertices + self.root[:, None, :]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class DrapedJets:
    """Posed patches of F frames: ``jet`` (F, K, 45), ``rotation`` (F, K, 3, 3) and ``centre`` [m] (F, K, 3) float32.

    Centres are relative to ``root``. Jets hold the push-out but for ``left_m`` (F,), the longest way that a vertex
    lacks to it. The rest is that of ``Draped``.
    """

    jet: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray
    left_m: np.ndarray
    root: np.ndarray
    pushed: bool
    pushed_share: np.ndarray
    push_max_m: np.ndarray
    memories: tuple[Memory | None, ...]


Frames = TypeVar("Frames", Draped, DrapedJets)


class Drapery:
    """Everything a start loads: body, model, garments, clips; and the thread that computes.

    One thread: the graph uses its own threads, and numbers then do not depend on who else waits.
    Clips are computed in chunks, so that a long one lets waiting stream frames through.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.body: BodyModel = load_body(settings.body)
        folder = settings.models_dir / settings.model
        self.engine = Engine(
            folder, device=settings.device, int8=settings.int8, half=settings.half, bound=settings.buckets
        )
        self.engine.check_body(self.body)
        self.engine.check_passes(settings.passes)
        self.pusher = Pusher(self.engine, self.body)
        self.packer = Packer(self.engine, self.body) if self.engine.packs else None
        self.garments = Registry(self.engine, self.body, settings, self.packer, self.pusher)
        self.motions = Motions(settings.motions_dir)
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="drape")
        self.warm_up()

    def close(self) -> None:
        """Waits for the running chunk and ends the thread."""
        self._executor.shutdown(wait=True, cancel_futures=True)

    def warm_up(self) -> None:
        """One frame of one garment, so that the first request does not pay for lazy set-up; where shapes have buckets,
        one frame and a chunk of every garment, in each way that frames are asked for."""
        count = self.body.shape_count
        entries = self.garments.entries()
        for entry in entries if self.engine.bound else entries[:1]:
            for frames in (1, self.settings.chunk_frames) if self.engine.bound else (1,):
                rest = PoseInput(np.zeros((frames, 24, 3)), np.zeros((frames, 3)), np.zeros(count), push=True)
                self.compute(entry, [rest])
                if self.engine.bound and self.engine.tells_jets:
                    self.compute_jets(entry, [rest])
        if self.engine.dynamic:
            still = nothing(self.engine)
            self.engine.advance(np.zeros((1, 24, 12)), still.state[None], np.array([1.0 / 30.0]))

    @property
    def device_bytes(self) -> int:
        """Memory of the garments' constants and of buckets where the graphs compute."""
        return self.pusher.held_bytes + (self.packer.held_bytes if self.packer else 0)

    @property
    def buckets(self) -> int:
        """Sets of shapes with memory of their own, none where calls take it anew."""
        return self.pusher.buckets + (self.packer.buckets if self.packer else 0)

    def check_body_id(self, name: str) -> None:
        """Refuses a body that this service has not loaded."""
        if name != self.body.name:
            raise NotFound(
                "body", expected=self.body.name, got=name, cure="GET /bodies lists the bodies of this service."
            )

    async def in_thread(self, function: Callable[..., Result], *arguments: object) -> Result:
        """``function(*arguments)`` on the worker thread."""
        return await asyncio.get_running_loop().run_in_executor(self._executor, partial(function, *arguments))

    async def prepare(self, scene: Scene) -> None:
        """Makes what an outfit's push-out needs, beside the frames that are being computed."""
        if isinstance(scene, Outfit):
            await asyncio.to_thread(self.pusher.prepare, [entry.garment.digest for entry in scene.layers])

    async def drape(self, entry: Scene, motion: PoseInput) -> Draped:
        """The draped clip, chunk by chunk."""
        return _joined([part async for part in self._chunks(self.compute, entry, motion)])

    async def drape_jets(self, entry: Scene, motion: PoseInput) -> DrapedJets:
        """The draped clip as posed patches, chunk by chunk."""
        return _joined([part async for part in self._chunks(self.compute_jets, entry, motion)])

    async def _chunks(
        self, compute: Callable[[Scene, Sequence[PoseInput]], Frames], entry: Scene, motion: PoseInput
    ) -> AsyncIterator[Frames]:
        if motion.push:
            await self.prepare(entry)
        size = self.settings.chunk_frames
        memory = motion.memory
        for i in range(0, len(motion.poses), size):
            part = await self.in_thread(compute, entry, [motion.part(slice(i, i + size), memory)])
            memory = part.memories[0]
            yield part

    def check_geometry(self, asked: Geometry) -> Geometry:
        """``asked``; refuses (``InputError``) jets of a model whose graphs do not say them."""
        if asked == "jets" and not self.engine.tells_jets:
            raise InputError(
                "geometry",
                expected=f"vertices: model {self.engine.manifest.name} does not say its jets",
                got=asked,
                cure="Ask for vertices, or export the model again.",
            )
        return asked

    def passes(self, asked: int | None) -> int | None:
        """How many corrections run: what was ``asked`` for, else the setting; None for all. Refuses what cannot be."""
        return self.engine.check_passes(self.settings.passes if asked is None else asked)

    def motion_knob(self, asked: float | None) -> float:
        """How much motion counts: what was ``asked`` for, else all of it; nothing where the model is static."""
        return (1.0 if asked is None else asked) if self.engine.dynamic else 0.0

    async def pose_body(self, motion: PoseInput) -> np.ndarray:
        """World vertices [m] (F, Vb, 3) float32 of the body."""
        size = self.settings.chunk_frames
        return np.concatenate(
            [
                await self.in_thread(
                    self._body_chunk, motion.poses[i : i + size], motion.trans[i : i + size], motion.betas
                )
                for i in range(0, len(motion.poses), size)
            ]
        )

    def _body_chunk(self, poses: np.ndarray, trans: np.ndarray, betas: np.ndarray) -> np.ndarray:
        return self.body.posed_vertices(poses, trans, betas).astype(np.float32)

    def compute(self, scene: Scene, motions: Sequence[PoseInput]) -> Draped:
        """All frames of ``motions``, which may differ in shape, of one garment or outfit in one run of the graph.

        The vertices of an outfit's garments follow each other as its layers do.
        """
        drapes, roots, memories = self._drape(scene.layers, motions, "vertices", skin=any(m.push for m in motions))
        layers, count = [drape["vertices"] for drape in drapes], len(roots)
        share, furthest = np.zeros(count), np.zeros(count)
        start = 0
        for motion in motions:
            rows = slice(start, start + len(motion.poses))
            start = rows.stop
            if motion.push:
                way = self._push(scene.layers, layers, rows, motion, drapes[0].get(SKIN))
                share[rows], furthest[rows] = (way > MOVED_M).mean(axis=1), way.max(axis=1)
        vertices = layers[0] if len(layers) == 1 else np.concatenate(layers, axis=1)
        return Draped(vertices, roots, any(m.push for m in motions), share, furthest, memories)

    def compute_jets(self, scene: Scene, motions: Sequence[PoseInput]) -> DrapedJets:
        """``compute`` as posed patches; those of an outfit's garments follow each other. Vertices only to push them."""
        pushes = any(motion.push for motion in motions)
        layers, roots, memories = self._drape(scene.layers, motions, "both" if pushes else "jets", skin=pushes)
        jet = [jets.full(layer["jet"]) for layer in layers]
        count, start = len(roots), 0
        share, furthest, left = np.zeros(count), np.zeros(count), np.zeros(count)
        for motion in motions:
            rows = slice(start, start + len(motion.poses))
            start = rows.stop
            if motion.push:
                pushed = self._push_jets(scene.layers, layers, rows, motion)
                for own, part in zip(jet, pushed, strict=True):
                    own[rows] = part.jet
                way = np.concatenate([part.way_m for part in pushed], axis=1)
                share[rows], furthest[rows] = (way > MOVED_M).mean(axis=1), way.max(axis=1)
                left[rows] = np.max([part.left_m for part in pushed], axis=0)
        rotation, centre = (np.concatenate([layer[name] for layer in layers], axis=1) for name in JETS[1:])
        whole = np.concatenate(jet, axis=1)
        return DrapedJets(whole, rotation, centre, left, roots, pushes, share, furthest, memories)

    def _drape(
        self, layers: Sequence[Entry], motions: Sequence[PoseInput], shape: Shape, *, skin: bool
    ) -> tuple[list[dict[str, np.ndarray]], np.ndarray, tuple[Memory | None, ...]]:
        """Of each layer the outputs of ``shape`` for all frames (F, ...) by name, by the packed graph where it is.

        With ``skin`` the first layer's hold the posed skin too, where that graph poses it for the push-out.
        Relative to the roots [m] (F, 3), which come second; third, what each input's body leaves behind.
        """
        codes, memories = self._follow(motions)
        outputs = OUTPUTS_OF[shape]
        if self.packer is None:
            feels = self.engine.feels_body
            feed = _joined_feed([body_feed(self.body, m.poses, m.trans, m.betas, skin=feels) for m in motions])
            drapes = [self.engine.drape_outputs({**feed.arrays, **entry.feed, **codes}, outputs) for entry in layers]
            return [dict(zip(outputs, drape, strict=True)) for drape in drapes], feed.root, memories
        shapes = [pack_body(self.body, m.betas) for m in motions]
        rows = [shape.rows(m.poses) for shape, m in zip(shapes, motions, strict=True)]
        bodies = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
        roots = np.concatenate([m.trans + shape.root for shape, m in zip(shapes, motions, strict=True)])
        items = [(entry.garment.digest, frame) for entry in layers for frame in range(len(roots))]
        # Bodies with pose blend shapes have another skin than their bones carry.
        skin = skin and self.engine.shares_skin and self.body.posedirs is None
        results = self.packer.run(ScenePlan(shape, skin=skin, passes=motions[0].passes), bodies | codes, items)
        check_finite(self.engine, all(result.finite for result in results))
        frames = len(roots)
        parts = [results[i * frames : (i + 1) * frames] for i in range(len(layers))]
        stacked = [{name: np.stack([result.arrays[name] for result in part]) for name in outputs} for part in parts]
        if skin:
            stacked[0][SKIN] = np.stack([result.arrays[SKIN] for result in parts[0]])
        return stacked, roots, memories

    def _follow(self, motions: Sequence[PoseInput]) -> tuple[dict[str, np.ndarray], tuple[Memory | None, ...]]:
        """``dynamic_code`` (F, C) of all frames, times the knob, and the memories after them; empty of a static model.

        Frame by frame, since each needs the state after the one before; the inputs of a frame go together. Where the
        knob is 0 neither kinematics nor recurrence are computed, and codes are zero.
        """
        if not self.engine.dynamic:
            return {}, tuple(m.memory for m in motions)
        memories = [(m.memory or nothing(self.engine)) if m.motion > 0.0 else None for m in motions]
        codes = [np.zeros((len(m.poses), self.engine.code_size), np.float32) for m in motions]
        bodies = {
            i: kinematics(self.body, m.poses, m.trans, m.betas)
            for i, m in enumerate(motions)
            if memories[i] is not None
        }
        for frame in range(max((len(motions[i].poses) for i in bodies), default=0)):
            rows, before, moments = [], [], []
            for i, at in bodies.items():
                motion, memory = motions[i], memories[i]
                if frame < len(motion.poses):
                    assert memory is not None and motion.times_s is not None
                    rows.append(i)
                    before.append(memory)
                    moments.append(Moment(float(motion.times_s[frame]), at[frame]))
            for i, memory in zip(rows, advance(self.engine, before, moments), strict=True):
                memories[i] = memory
                codes[i][frame] = np.float32(motions[i].motion) * memory.code
        return {"dynamic_code": np.concatenate(codes)}, tuple(memories)

    def _push(
        self, layers: Sequence[Entry], drapes: list[np.ndarray], rows: slice, motion: PoseInput, skin: np.ndarray | None
    ) -> np.ndarray:
        """Moves the frames ``rows`` of ``drapes`` out of the body and of the layers below; ways [m] (F, sum of V).

        ``skin`` of all frames, where the drape has it.
        """
        posed = None if skin is None else skin[rows]
        keys, pushed, ways = [entry.garment.digest for entry in layers], [], []
        for layer, key in enumerate(keys):
            vertices, place = drapes[layer][rows], (motion.poses, motion.betas, self.settings.clearance_m)
            if layer == 0:
                moved, way = self.pusher.push(key, vertices, *place, skin=posed)
            else:
                under = np.concatenate(pushed, axis=1)
                moved, way = self.pusher.push_over(keys[: layer + 1], vertices, under, *place, skin=posed)
            drapes[layer][rows] = moved
            pushed.append(moved)
            ways.append(way)
        return np.concatenate(ways, axis=1)

    def _push_jets(
        self, layers: Sequence[Entry], drapes: Sequence[dict[str, np.ndarray]], rows: slice, motion: PoseInput
    ) -> list[PushedJets]:
        """The push-out of the frames ``rows`` of every layer, out of the body and of the layers below, in its jets."""
        keys, pushed = [entry.garment.digest for entry in layers], []
        skin = drapes[0].get(SKIN)
        given = None if skin is None else skin[rows]
        for layer, drape in enumerate(drapes):
            under = np.concatenate([part.vertices for part in pushed], axis=1) if pushed else None
            posed = PosedJets(drape["jet"][rows], drape["frame_rotation"][rows])
            vertices, clearance_m = drape["vertices"][rows], self.settings.clearance_m
            pushed.append(
                self.pusher.push_jets(
                    keys[: layer + 1], vertices, under, posed, motion.poses, motion.betas, clearance_m, skin=given
                )
            )
        return pushed


def _joined_feed(feeds: Sequence[BodyFeed]) -> BodyFeed:
    if len(feeds) == 1:
        return feeds[0]
    arrays = {key: np.concatenate([feed.arrays[key] for feed in feeds]) for key in feeds[0].arrays}
    return BodyFeed(arrays, np.concatenate([feed.root for feed in feeds]))


def _joined(parts: Sequence[Frames]) -> Frames:
    """The chunks of a clip one after the other."""
    names = [item.name for item in fields(parts[0]) if isinstance(getattr(parts[0], item.name), np.ndarray)]
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return replace(parts[0], **joined, memories=parts[-1].memories)
