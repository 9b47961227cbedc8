"""The methods of both clients, each written once as the calls that it makes; ``clients.client`` sends these.

A method returns its only ``Call``, or a generator of steps. A client sends each ``Call`` that the generator yields and
hands it the answer, waits for each ``Pause``, and returns what the generator returns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import httpx
import numpy as np

from clients import calls, clip_pieces
from clients.calls import (
    BINARY,
    GLB,
    Answer,
    BodyShape,
    Call,
    Motion,
    at_root,
    drape_call,
    get_call,
    name_sizes,
    post_call,
    url_path,
)
from clients.job_steps import Progress, Steps, exact_clip_steps, upload_steps
from clients.mesh_files import check_at_once, glb_of, surface_of
from drape.motion.clip import MotionClip
from drape.wire.clip_message import frame_bytes
from drape.wire.jets import JetFrame
from drape.wire.layout import JetLayout
from drape.wire.options import Resolution


class Methods:
    """The calls of a client. The service is asked once how many frames a request may have, and longer clips go in
    pieces.

    A dictionary that is returned has the fields of the service's class that the method names; a service lists these at
    ``/docs``.
    """

    def __init__(self) -> None:
        self._health: dict[str, Any] | None = None

    def health(self) -> Call[dict[str, Any]]:
        """Returns the service's version, model, body, provider and limits (``Health``)."""
        return get_call("health")

    def garments(self) -> Call[list[dict[str, Any]]]:
        """Returns the garments that can be draped, a ``GarmentInfo`` each. A drape names one by its ``id``."""
        return get_call("garments")

    def tiers(self) -> Call[list[dict[str, Any]]]:
        """Returns the tiers that a drape may name by ``id``, the cheapest first, a ``TierInfo`` each."""
        return get_call("tiers")

    def avatars(self) -> Call[list[dict[str, Any]]]:
        """Returns the avatars that can wear garments, each with its ``id``, joints, fit and height (``AvatarInfo``)."""
        return get_call("avatars")

    def about_avatar(self, avatar: str) -> Call[dict[str, Any]]:
        """Returns the avatar with this id: its joints and how they were found, its nodes, fit and height, and what it
        can wear (``AvatarWears``)."""
        return get_call("avatars", avatar)

    def remove_avatar(self, avatar: str) -> Call[bytes]:
        """Removes an avatar from the service; returns empty bytes."""
        return Call("DELETE", url_path("avatars", avatar), calls.read_bytes)

    def fabrics(self) -> Call[list[dict[str, Any]]]:
        """Returns the fabrics that a drape may name by ``id``, each with its numbers (``FabricInfo``)."""
        return get_call("fabrics")

    def bodies(self) -> Call[list[dict[str, Any]]]:
        """Returns the bodies of the service, each with its ``id`` and its numbers of vertices, faces and shape
        coefficients (``BodyInfo``)."""
        return get_call("bodies")

    def motions(self) -> Call[list[dict[str, Any]]]:
        """Returns the sample clips of the service, a ``MotionInfo`` each: ``id``, name, number of frames, frames a
        second."""
        return get_call("motions")

    def motion(self, name: str, betas: np.ndarray | None = None, avatar: str | None = None) -> Call[MotionClip]:
        """Returns the sample clip ``name`` with the soles on the ground of the body in the shape ``betas``, or of an
        avatar. Poses are (F, 24, 3) [rad], translations (F, 3) [m]."""
        more = {} if avatar is None else {"avatar": avatar}
        return get_call("motions", name, read=calls.read_clip, betas=betas, **more)

    def placed(self, clip: MotionClip, betas: np.ndarray | None = None, avatar: str | None = None) -> Steps[MotionClip]:
        """Returns ``clip`` moved so that the soles of the service's body in the shape ``betas``, or of an avatar, stand
        on the ground."""
        if avatar is not None:
            found = yield get_call("avatars", avatar)
            return calls.place_clip(clip, found | {"joints": found["rest_joints"]})
        name = (yield self.bodies())[0]["id"]
        return calls.place_clip(clip, (yield get_call("bodies", name, betas=betas)))

    def measures(self, betas: np.ndarray | None = None) -> Steps[dict[str, Any]]:
        """Returns the ``measures`` [m, kg] by name of the service's body in the shape ``betas``, and their ``ranges``
        (``MeasuresDocument``)."""
        name = (yield self.bodies())[0]["id"]
        return (yield get_call("bodies", name, "measures", betas=betas))

    def shape(self, **measures: float) -> Steps[dict[str, Any]]:
        """Returns the likeliest ``betas`` of the service's body for ``measures``, such as ``height_m=1.7``, all
        ``measures`` of that shape, and by how much it is above given ones that are ``missed`` (``ShapeDocument``)."""
        name = (yield self.bodies())[0]["id"]
        return (yield post_call(measures, "bodies", name, "shapes"))

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
        """Returns where ``garment`` is tight or loose on a body, in words and numbers (``FitDocument``); ``pose`` is
        (24, 3) [rad].

        With ``vertices`` the answer also has the strain along warp and weft and the pressure [N/m^2] of each vertex.
        """
        body = {
            name: None if of is None else np.asarray(of).tolist() for name, of in (("betas", betas), ("pose", pose))
        }
        return post_call({**body, "fabric": fabric, "size": size, "vertices": vertices}, "garments", garment, "fit")

    def size(self, garment: str, betas: np.ndarray | None = None) -> Call[dict[str, str]]:
        """Returns the ``size`` of ``garment`` that fits the service's body in the shape ``betas``, and the reason in
        ``words``.
        """
        return get_call("garments", garment, "size", betas=betas)

    def mesh(self, garment: str, resolution: Resolution = "delivered", size: str | None = None) -> Call[dict[str, Any]]:
        """Returns the garment's mesh of a ``resolution`` at rest as lists (``MeshDocument``): ``vertices`` (V, 3) [m],
        ``faces`` (F, 3), texture coordinates ``uv`` (T, 2), and ``uv_faces`` (F, 3), which are indices of these."""
        more: dict[str, Any] = {} if size is None else {"size": size}
        return get_call("garments", garment, "mesh", resolution=resolution, **more)

    def preview(self, garment: str, size: int = 512) -> Call[bytes]:
        """Returns the bytes of a PNG picture of a garment at rest on its body, ``size`` pixels wide and high, 64 to
        1,024."""
        return get_call("garments", garment, "preview.png", read=calls.read_bytes, accept="image/png", size=str(size))

    def jet_layout(
        self, garment: str, resolution: Resolution = "delivered", avatar: str | None = None, size: str | None = None
    ) -> Call[JetLayout]:
        """Returns the layout that makes vertices of a garment's jets, on the delivered mesh or the fine one.

        It is the same for all frames of a garment in one ``size`` on one ``avatar``.
        """
        more = {"avatar": avatar, "size": size}
        asked: dict[str, str] = {"resolution": resolution} | {k: v for k, v in more.items() if v is not None}
        return Call("GET", url_path("garments", garment, "jets"), calls.read_layout, asked, {"Accept": BINARY})

    def upload_garment(
        self,
        path: str | Path,
        avatar: str | dict[str, Any] | None = None,
        *,
        name: str | None = None,
        wait_s: float = 600.0,
        progress: Progress = lambda job: None,
    ) -> Steps[str]:
        """Uploads a garment file, waits for its job, and returns the id of the new garment.

        ``avatar``: the body that it was modelled on. ``progress`` is called with each state of the job; an exception
        that it raises cancels the upload.
        """
        return (yield from upload_steps(calls.upload_call(Path(path), avatar, name), "garment", wait_s, progress))

    def upload_avatar(
        self,
        path: str | Path,
        *,
        name: str | None = None,
        alive: bool = False,
        wait_s: float = 600.0,
        progress: Progress = lambda job: None,
    ) -> Steps[str]:
        """Uploads a character as GLB or VRM, waits for its job, and returns the id of the new avatar.

        A drape takes the id as ``avatar``. ``alive``: its own clothes become garments, for the option ``alive`` of a
        drape. ``progress`` is that of ``upload_garment``.
        """
        return (yield from upload_steps(calls.upload_avatar_call(Path(path), name, alive), "avatar", wait_s, progress))

    def posed_avatar(self, avatar: str, motion: Motion, *, trans: np.ndarray | None = None) -> Steps[np.ndarray]:
        """Returns the vertices (F, V, 3) [m], float32, of an avatar's own surface in the world."""
        clip, about = calls.motion_of(motion, BodyShape(trans))
        path, accept = url_path("avatars", avatar, "posed"), {"Accept": BINARY}
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
        """Returns the vertices (F, V, 3) [m], float32, of ``garment`` draped over ``motion``, in the world.

        ``motion``: a clip, or poses (F, 24, 3) [rad]. ``trans``: the root translations (F, 3) [m] of poses. ``betas``:
        the body's shape. ``options`` are the fields of ``drape.wire.options.DrapeOptions``, and also ``size`` and
        ``avatar``, the id of an avatar that wears the garment. An option that is left out has the service's default.
        The other methods that drape take the same arguments.
        """
        return self._whole(drape_call(calls.read_vertices, garment, motion, BodyShape(trans, betas), options))

    def drape_at_root(
        self,
        garment: str,
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        **options: Any,
    ) -> Steps[tuple[np.ndarray, np.ndarray]]:
        """Drapes as ``drape`` does, and returns vertices (F, V, 3) [m], float32, relative to the roots, and the roots
        (F, 3) [m], float64.

        Far from the world's origin the sum of both in float64 keeps the garment's shape, where ``drape`` rounds it.
        """
        return self._whole(at_root(drape_call(calls.read_vertices, garment, motion, BodyShape(trans, betas), options)))

    def drape_outfit(
        self,
        garments: Sequence[str],
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        **options: Any,
    ) -> Steps[list[np.ndarray]]:
        """Drapes several garments worn over each other, the innermost first, and returns the vertices (F, V, 3) [m],
        float32, of each in the world."""
        return self._whole(drape_call(calls.read_clip_layers, list(garments), motion, BodyShape(trans, betas), options))

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
        """Drapes as ``drape_outfit`` does, and yields the vertices (f, V, 3) [m] of each garment for at most
        ``at_once`` frames at a time.

        Memory holds no more frames than that, however long the clip is.
        """
        return self._pieces(
            drape_call(calls.read_clip_layers, _listed(garment), motion, BodyShape(trans, betas), options), at_once
        )

    def drape_jets(
        self,
        garment: str | Sequence[str],
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        **options: Any,
    ) -> Steps[list[JetFrame]]:
        """Drapes as ``drape`` does, and returns each frame as posed patches.

        ``jet_layout(garment).vertices(frame)`` makes vertices (V, 3) [m] of one. ``frame.layers(counts)`` splits the
        patches of several garments worn over each other.
        """
        asked = {**options, "geometry": "jets"}
        return self._whole(drape_call(calls.read_jets, garment, motion, BodyShape(trans, betas), asked))

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
        joints: int | None = None,
        **options: Any,
    ) -> Steps[bytes]:
        """Returns the bytes of an animated GLB of a garment, or of several worn over each other.

        With ``body`` the GLB also holds the body. With ``rig`` the garments are skinned to the nodes of the
        ``avatar``'s own file, with morph targets or with so many ``joints`` of their own. With ``quantised``
        (KHR_mesh_quantization) the GLB has half the size of float32. The client writes the GLB of a clip that is too
        long for one request; such a GLB has neither body nor rig (``InputError``).
        """
        shape = BodyShape(trans, betas, fps)
        more = {"body": body, "quantised": quantised} | ({"rig": True} if rig else {})
        more |= {} if joints is None else {"joints": joints}
        call = drape_call(calls.read_bytes, garment, motion, shape, options, accept=GLB, more=more)
        assert call.clip is not None
        most = yield from self._at_once(call.clip.poses)
        if len(call.clip.poses) <= most:
            return (yield call)
        check_at_once(call, most)
        rooted = at_root(drape_call(calls.read_vertices, garment, motion, shape, options))
        vertices, roots = yield from self._whole(rooted)
        meshes = []
        for name, size in name_sizes(_listed(garment), options.get("size")):
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
        """Drapes in tier exact: starts a job, waits for its end, and returns vertices (F, V, 3) [m], float32, in the
        world, or with ``glb`` the bytes of an animated GLB.

        ``progress`` is called with each state of the job; an exception that it raises ends the waiting and not the job.
        The same call with ``more={"job": id}`` goes on waiting for that job.
        """
        options = {**options, "tier": "exact"}
        asked = drape_call(httpx.Response.json, garment, motion, BodyShape(trans, betas), options, more=more)
        return (yield from exact_clip_steps(asked, GLB if glb else BINARY, progress))

    def body_mesh(self, body: str) -> Call[dict[str, Any]]:
        """Returns the mesh of a body at rest as lists: ``vertices`` (V, 3) [m] and ``faces`` (F, 3)."""
        return get_call("bodies", body, "mesh")

    def posed_body(
        self, body: str, motion: Motion, *, trans: np.ndarray | None = None, betas: np.ndarray | None = None
    ) -> Steps[np.ndarray]:
        """Returns the vertices (F, V, 3) [m], float32, of the posed body in the world."""
        clip, about = calls.motion_of(motion, BodyShape(trans, betas))
        path, accept = url_path("bodies", body, "posed"), {"Accept": BINARY}
        return self._whole(Call("POST", path, calls.read_vertices, headers=accept, json=about, clip=clip))

    def _whole(self, call: Call[Answer]) -> Steps[Answer]:
        """The answer to ``call``, in pieces if its clip is longer than the service takes at once."""
        answers = []
        for piece in self._pieces(call):
            answers.append((yield from piece))
        return clip_pieces.joined_answers(answers)

    def _pieces(self, call: Call[Answer], at_once: int | None = None) -> Iterator[Steps[Answer]]:
        """The steps to the answer for each piece of ``call``, of ``at_once`` frames or of as many as the service takes.

        The steps of one piece must be taken before the next piece is asked for.
        """
        assert call.clip is not None
        poses, frames, end, past = call.clip.poses, len(call.clip.poses), 0, None

        def piece() -> Steps[Answer]:
            nonlocal end, past
            most = yield from self._at_once(poses)
            rows = slice(end, min(frames, end + (most if at_once is None else min(at_once, most))))
            answer, past = yield clip_pieces.piece(call, rows, past)
            end = rows.stop
            return answer

        yield piece()
        while end < frames:
            yield piece()

    def _at_once(self, poses: np.ndarray) -> Steps[int]:
        """The number of ``poses`` that the service takes at once; it is asked once, when they are many."""
        if len(poses) <= clip_pieces.UNASKED:
            return max(1, len(poses))
        health = self._health
        if health is None:
            health = self._health = yield self.health()
        return clip_pieces.most_frames(health, frame_bytes(poses))


def _listed(garment: str | Sequence[str]) -> Sequence[str]:
    return [garment] if isinstance(garment, str) else garment
