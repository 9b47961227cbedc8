"""The clients' methods, each written once as the calls that it makes; ``clients.client`` makes them, waiting or not.

A method returns its only call, or a generator of steps: it is sent the answer to each ``Call`` that it yields, lets
the time of a ``Pause`` pass, and returns its own answer.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import httpx
import numpy as np

from clients import calls, pieces
from clients.calls import BINARY, GLB, Answer, Body, Call, Motion, at_root, draped, fetched, path_of, sent, sized
from clients.jobs import Progress, Steps, exact_clip, made
from clients.meshes import check_at_once, glb_of, surface_of
from drape.motion.clip import MotionClip
from drape.wire.clips import frame_bytes
from drape.wire.jets import JetFrame
from drape.wire.layout import JetLayout
from drape.wire.options import Resolution


class Methods:
    """All calls of a client. The service is asked once how many frames it takes at once."""

    def __init__(self) -> None:
        self._health: dict[str, Any] | None = None

    def health(self) -> Call[dict[str, Any]]:
        """Whether the service works, and with what."""
        return fetched("health")

    def garments(self) -> Call[list[dict[str, Any]]]:
        """The garments that can be draped; ``id`` names one."""
        return fetched("garments")

    def tiers(self) -> Call[list[dict[str, Any]]]:
        """The tiers that a drape may name, the least first, with what was measured of each."""
        return fetched("tiers")

    def avatars(self) -> Call[list[dict[str, Any]]]:
        """The characters that can wear garments: joints, fit, height."""
        return fetched("avatars")

    def about_avatar(self, avatar: str) -> Call[dict[str, Any]]:
        """What the service tells of one character: joints, how they were found, nodes, fit, height."""
        return fetched("avatars", avatar)

    def remove_avatar(self, avatar: str) -> Call[bytes]:
        """Removes a character from the service."""
        return Call("DELETE", path_of("avatars", avatar), calls.read_bytes)

    def fabrics(self) -> Call[list[dict[str, Any]]]:
        """The fabrics that a drape may name, with their numbers."""
        return fetched("fabrics")

    def bodies(self) -> Call[list[dict[str, Any]]]:
        """The bodies of the service."""
        return fetched("bodies")

    def motions(self) -> Call[list[dict[str, Any]]]:
        """The sample clips of the service."""
        return fetched("motions")

    def motion(self, name: str, betas: np.ndarray | None = None, avatar: str | None = None) -> Call[MotionClip]:
        """One sample clip, placed on the ground for the service's body in the shape ``betas``, or for an avatar."""
        more = {} if avatar is None else {"avatar": avatar}
        return fetched("motions", name, read=calls.read_clip, betas=betas, **more)

    def placed(self, clip: MotionClip, betas: np.ndarray | None = None, avatar: str | None = None) -> Steps[MotionClip]:
        """A clip from a file, placed on the ground for the service's body in the shape ``betas``, or for an avatar."""
        if avatar is not None:
            found = yield fetched("avatars", avatar)
            return calls.placed(clip, found | {"joints": found["rest_joints"]})
        name = (yield self.bodies())[0]["id"]
        return calls.placed(clip, (yield fetched("bodies", name, betas=betas)))

    def measures(self, betas: np.ndarray | None = None) -> Steps[dict[str, Any]]:
        """The measures of the service's body in the shape ``betas``, and the range of each."""
        name = (yield self.bodies())[0]["id"]
        return (yield fetched("bodies", name, "measures", betas=betas))

    def shape(self, **measures: float) -> Steps[dict[str, Any]]:
        """The likeliest ``betas`` of the service's body that have ``measures``, such as ``height_m=1.7``; what they
        reach, and what they miss."""
        name = (yield self.bodies())[0]["id"]
        return (yield sent(measures, "bodies", name, "shapes"))

    def fit(
        self,
        garment: str,
        *,
        betas: np.ndarray | None = None,
        pose: np.ndarray | None = None,
        fabric: str | dict[str, Any] | None = None,
        size: str | None = None,
        vertices: bool = False,
    ) -> Call[dict[str, Any]]:
        """Where ``garment`` is tight or loose on a body, in words and numbers; ``pose`` is (24, 3) [rad].

        With ``vertices`` also strain along warp and weft and pressure [N/m^2] of each.
        """
        body = {
            name: None if of is None else np.asarray(of).tolist() for name, of in (("betas", betas), ("pose", pose))
        }
        return sent({**body, "fabric": fabric, "size": size, "vertices": vertices}, "garments", garment, "fit")

    def size(self, garment: str, betas: np.ndarray | None = None) -> Call[dict[str, str]]:
        """The ``size`` of ``garment`` that the service's body in the shape ``betas`` takes, and why in ``words``."""
        return fetched("garments", garment, "size", betas=betas)

    def mesh(self, garment: str, resolution: Resolution = "delivered", size: str | None = None) -> Call[dict[str, Any]]:
        """Rest vertices [m], faces, uv and uv_faces of a garment, of the mesh that a drape of ``resolution`` has."""
        more: dict[str, Any] = {} if size is None else {"size": size}
        return fetched("garments", garment, "mesh", resolution=resolution, **more)

    def preview(self, garment: str, size: int = 512) -> Call[bytes]:
        """A PNG of a garment at rest on its body, ``size`` pixels along each side, 64 to 1,024."""
        return fetched("garments", garment, "preview.png", read=calls.read_bytes, accept="image/png", size=str(size))

    def jet_layout(
        self,
        garment: str,
        resolution: Resolution = "delivered",
        avatar: str | None = None,
        size: str | None = None,
    ) -> Call[JetLayout]:
        """The layout that makes vertices of a garment's jets, on its own mesh or a finer one; constant per garment,
        ``size``, and ``avatar`` that it is cut for."""
        more = {"avatar": avatar, "size": size}
        asked: dict[str, str] = {"resolution": resolution} | {k: v for k, v in more.items() if v is not None}
        return Call("GET", path_of("garments", garment, "jets"), calls.read_layout, asked, {"Accept": BINARY})

    def upload_garment(
        self,
        path: str | Path,
        avatar: str | dict[str, Any] | None = None,
        *,
        name: str | None = None,
        wait_s: float = 600.0,
        progress: Progress = lambda job: None,
    ) -> Steps[str]:
        """Uploads a garment file, waits for its job and returns the new garment's id.

        ``progress`` is told the job as often as it is asked for; what it raises ends the upload too.
        """
        return (yield from made(calls.upload(Path(path), avatar, name), "garment", wait_s, progress))

    def upload_avatar(
        self,
        path: str | Path,
        *,
        name: str | None = None,
        wait_s: float = 600.0,
        progress: Progress = lambda job: None,
    ) -> Steps[str]:
        """Uploads a character, GLB or VRM, waits for its job and returns the new avatar's id: ``avatar`` of a drape.

        ``progress`` as in ``upload_garment``.
        """
        return (yield from made(calls.upload_avatar(Path(path), name), "avatar", wait_s, progress))

    def posed_avatar(self, avatar: str, motion: Motion, *, trans: np.ndarray | None = None) -> Steps[np.ndarray]:
        """World vertices [m] (F, V, 3) float32 of a character's own surface."""
        clip, about = calls.motion_of(motion, Body(trans))
        path, accept = path_of("avatars", avatar, "posed"), {"Accept": BINARY}
        return self._whole(Call("POST", path, calls.read_vertices, headers=accept, json=about, clip=clip))

    def drape(
        self,
        garment: str,
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        **options: Any,
    ) -> Steps[np.ndarray]:
        """World vertices [m] (F, V, 3) float32 of ``garment`` over a clip or poses (F, 24, 3) [rad].

        ``options`` are those of ``drape.wire.options.DrapeOptions``, the service's own where left out, ``avatar``:
        the id of a character that wears it, and ``size``, here and in the methods below.
        """
        return self._whole(draped(calls.read_vertices, garment, motion, Body(trans, betas), options))

    def drape_at_root(
        self,
        garment: str,
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        **options: Any,
    ) -> Steps[tuple[np.ndarray, np.ndarray]]:
        """``drape`` as vertices [m] (F, V, 3) float32 counted from the roots [m] (F, 3) float64, which follow.

        Far from the world's origin their sum in float64 keeps the garment's shape, where ``drape`` rounds it.
        """
        return self._whole(at_root(draped(calls.read_vertices, garment, motion, Body(trans, betas), options)))

    def drape_outfit(
        self,
        garments: Sequence[str],
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        **options: Any,
    ) -> Steps[list[np.ndarray]]:
        """``drape`` of several garments worn over each other, the innermost first; vertices of each."""
        return self._whole(draped(calls.read_layers, list(garments), motion, Body(trans, betas), options))

    def drape_frames(
        self,
        garment: str | Sequence[str],
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        at_once: int = 240,
        **options: Any,
    ) -> Iterator[Steps[list[np.ndarray]]]:
        """``drape_outfit`` as vertices [m] (f, V, 3) of each garment, at most ``at_once`` frames at a time.

        No more is held of a clip of any length.
        """
        return self._pieces(draped(calls.read_layers, _listed(garment), motion, Body(trans, betas), options), at_once)

    def drape_jets(
        self,
        garment: str | Sequence[str],
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        **options: Any,
    ) -> Steps[list[JetFrame]]:
        """``drape`` as posed patches, a frame each: ``jet_layout(garment).vertices(frame)`` [m] (V, 3).

        ``frame.layers(counts)`` parts the patches of several garments worn over each other.
        """
        asked = {**options, "geometry": "jets"}
        return self._whole(draped(calls.read_jets, garment, motion, Body(trans, betas), asked))

    def drape_glb(
        self,
        garment: str | Sequence[str],
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        fps: float | None = None,
        body: bool = False,
        quantised: bool = True,
        rig: bool = False,
        **options: Any,
    ) -> Steps[bytes]:
        """An animated GLB of a garment, or of several over each other; with the body beside them if ``body``, or on the
        nodes of the ``avatar``'s own file if ``rig``.

        ``quantised`` (KHR_mesh_quantization) is half as large; float32 otherwise. A clip that comes in pieces is
        written here, without body or rig (``InputError``).
        """
        shape = Body(trans, betas, fps)
        more = {"body": body, "quantised": quantised} | ({"rig": True} if rig else {})
        call = draped(calls.read_bytes, garment, motion, shape, options, accept=GLB, more=more)
        assert call.clip is not None
        most = yield from self._at_once(call.clip.poses)
        if len(call.clip.poses) <= most:
            return (yield call)
        check_at_once(call, most)
        rooted = at_root(draped(calls.read_vertices, garment, motion, shape, options))
        vertices, roots = yield from self._whole(rooted)
        meshes = []
        for name, size in sized(_listed(garment), options.get("size")):
            meshes.append(surface_of((yield self.mesh(name, options.get("resolution") or "delivered", size))))
        return glb_of(call, meshes, vertices, roots)

    def exact(
        self,
        garment: str,
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        glb: bool = False,
        more: calls.Options = MappingProxyType({}),
        progress: Progress = lambda job: None,
        **options: Any,
    ) -> Steps[Any]:
        """``drape`` in tier exact: a job, whose end this waits for; with ``glb`` an animated GLB, as bytes.

        ``progress`` is told the job; what it raises ends the waiting alone. The same call with ``more`` as
        ``{"job": id}`` goes on waiting for a job that there is.
        """
        options = {**options, "tier": "exact"}
        asked = draped(httpx.Response.json, garment, motion, Body(trans, betas), options, more=more)
        return (yield from exact_clip(asked, GLB if glb else BINARY, progress))

    def body_mesh(self, body: str) -> Call[dict[str, Any]]:
        """The mesh of a body at rest: vertices [m] and faces."""
        return fetched("bodies", body, "mesh")

    def posed_body(
        self, body: str, motion: Motion, *, trans: np.ndarray | None = None, betas: np.ndarray | None = None
    ) -> Steps[np.ndarray]:
        """World vertices [m] (F, Vb, 3) float32 of the posed body."""
        clip, about = calls.motion_of(motion, Body(trans, betas))
        path, accept = path_of("bodies", body, "posed"), {"Accept": BINARY}
        return self._whole(Call("POST", path, calls.read_vertices, headers=accept, json=about, clip=clip))

    def _whole(self, call: Call[Answer]) -> Steps[Answer]:
        """The answer to ``call``, asked for in pieces where its clip is longer than the service takes at once."""
        answers = []
        for piece in self._pieces(call):
            answers.append((yield from piece))
        return pieces.joined(answers)

    def _pieces(self, call: Call[Answer], at_once: int | None = None) -> Iterator[Steps[Answer]]:
        """The steps to the answer for each piece of ``call``, of ``at_once`` frames or of as many as the service takes.

        The steps of one piece must be taken before the next piece is asked for.
        """
        assert call.clip is not None
        poses, frames, done, past = call.clip.poses, len(call.clip.poses), 0, None

        def piece() -> Steps[Answer]:
            nonlocal done, past
            most = yield from self._at_once(poses)
            rows = slice(done, min(frames, done + (most if at_once is None else min(at_once, most))))
            answer, past = yield pieces.piece(call, rows, past)
            done = rows.stop
            return answer

        yield piece()
        while done < frames:
            yield piece()

    def _at_once(self, poses: np.ndarray) -> Steps[int]:
        """The number of ``poses`` that the service takes at once; it is asked the first time that they are many."""
        if len(poses) <= pieces.UNASKED:
            return max(1, len(poses))
        health = self._health
        if health is None:
            health = self._health = yield self.health()
        return pieces.most_frames(health, frame_bytes(poses))


def _listed(garment: str | Sequence[str]) -> Sequence[str]:
    return [garment] if isinstance(garment, str) else garment
