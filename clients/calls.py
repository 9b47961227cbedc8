"""Every request that a client can make, and how its answer is read; shared by the sync and the async client."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar
from urllib.parse import quote

import httpx
import numpy as np

from clients.refusals import refusal
from drape.errors import InputError, MotionError
from drape.files.avatar_table import entry_for
from drape.files.formats import MESH_SUFFIXES
from drape.motion.clip import MotionClip
from drape.motion.grounding import placed_on_ground
from drape.wire.clips import check_motion, pack_clip
from drape.wire.jets import JetFrame, split_jets
from drape.wire.layout import JetLayout, unpack_layout
from drape.wire.options import Resolution, options_document

Answer = TypeVar("Answer")
Motion = MotionClip | np.ndarray
Options = Mapping[str, Any]

BINARY, GLB = "application/octet-stream", "model/gltf-binary"
DEFAULT_URL = "http://127.0.0.1:8000"
DEFAULT_FPS = 30.0
DRAPE = "/drape"
_STREAMED = {"streamed": True}  # so that the answer may be of any length


@dataclass(frozen=True, eq=False)
class Body:
    """Of a body in motion what a clip does not say: translations [m] (F, 3) in place of its own, shape, frame rate."""

    trans: np.ndarray | None = None
    betas: np.ndarray | None = None
    fps: float | None = None


@dataclass(frozen=True, eq=False)
class Clip:
    """The frames of a request: ``poses`` (F, 24, 3) [rad] and ``trans`` (F, 3) [m], None for zeros.

    Refuses (``MotionError``) other shapes.
    """

    poses: np.ndarray
    trans: np.ndarray | None

    def __post_init__(self) -> None:
        check_motion(self.poses, self.trans)

    def part(self, rows: slice) -> Clip:
        """The frames ``rows``."""
        return Clip(self.poses[rows], None if self.trans is None else self.trans[rows])


@dataclass(frozen=True)
class Call(Generic[Answer]):
    """One request and the reader of its answer; ``clip``: frames that it sends beside ``json``."""

    method: str
    path: str
    read: Callable[[httpx.Response], Answer]
    params: Mapping[str, str] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    json: Any = None
    content: bytes | None = None
    clip: Clip | None = None

    def arguments(self) -> dict[str, Any]:
        """What httpx's ``request`` takes."""
        content, headers = self.content, dict(self.headers)
        if self.clip is not None:
            content, headers["Content-Type"] = pack_clip(self.json, self.clip.poses, self.clip.trans), BINARY
        return {
            "method": self.method,
            "url": self.path,
            "params": dict(self.params),
            "headers": headers,
            "json": self.json if self.clip is None else None,
            "content": content,
        }

    def answer(self, response: httpx.Response) -> Answer:
        """The answer read; raises the service's refusal."""
        if response.is_success:
            return self.read(response)
        raise refusal(response)


# --- requests ---


def key_headers(key: str | None) -> dict[str, str]:
    """What every request says of who asks."""
    return {} if key is None else {"Authorization": f"Bearer {key}"}


def health() -> Call[dict[str, Any]]:
    return Call("GET", "/health", httpx.Response.json)


def listed(what: str) -> Call[list[dict[str, Any]]]:
    """All ``what`` that the service has: "garments", "tiers", "fabrics", "bodies" or "motions"."""
    return Call("GET", f"/{what}", httpx.Response.json)


def body(name: str, betas: np.ndarray | None) -> Call[dict[str, Any]]:
    return Call("GET", f"/bodies/{_quoted(name)}", httpx.Response.json, params=_betas_query(betas))


def motion(name: str, betas: np.ndarray | None) -> Call[MotionClip]:
    return Call("GET", f"/motions/{_quoted(name)}", _read_clip, params=_betas_query(betas))


def _betas_query(betas: np.ndarray | None) -> dict[str, str]:
    return {} if betas is None else {"betas": ",".join(repr(float(beta)) for beta in betas)}


def mesh(garment: str, resolution: Resolution) -> Call[dict[str, Any]]:
    path, headers = f"/garments/{_quoted(garment)}/mesh", {"Accept": "application/json"}
    return Call("GET", path, httpx.Response.json, params={"resolution": resolution}, headers=headers)


def preview(garment: str, size: int) -> Call[bytes]:
    path = f"/garments/{_quoted(garment)}/preview.png"
    return Call("GET", path, lambda response: response.content, params={"size": str(size)})


def jet_layout(garment: str, resolution: Resolution) -> Call[JetLayout]:
    path, headers = f"/garments/{_quoted(garment)}/jets", {"Accept": BINARY}
    return Call("GET", path, _read_layout, params={"resolution": resolution}, headers=headers)


def job(job_id: str) -> Call[dict[str, Any]]:
    return Call("GET", f"/jobs/{_quoted(job_id)}", httpx.Response.json)


def cancel(job_id: str) -> Call[None]:
    return Call("DELETE", f"/jobs/{_quoted(job_id)}", lambda response: None)


def _says_itself(entry: Any) -> bool:
    """Whether a table's entry means the same to the service: an object or ``standard``, not a mesh file."""
    return isinstance(entry, dict) or entry == "standard"


def upload(path: Path, avatar: str | dict[str, Any] | None, name: str | None) -> Call[dict[str, Any]]:
    """Sends a garment file; the answer is the job."""
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(
            path.name,
            expected=f"one of {', '.join(MESH_SUFFIXES)}",
            got=path.suffix or "no suffix",
            cure="Export the mesh so.",
        )
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(
            str(path), expected="a file that can be read", got=str(error.strerror), cure="Check the path."
        ) from error
    params = {"name": (name or path.stem) + path.suffix.lower()}
    if avatar is None:
        # The service cannot see the folder that the file lies in.
        found = entry_for(path.name, [path.parent])
        avatar = found[1] if found is not None and _says_itself(found[1]) else None
    if avatar is not None:
        params["avatar"] = json.dumps(avatar) if isinstance(avatar, dict) else avatar
    return Call(
        "POST", "/garments", httpx.Response.json, params=params, content=content, headers={"Content-Type": BINARY}
    )


def drape(garment: str | Sequence[str], motion: Motion, body: Body, options: Options) -> Call[np.ndarray]:
    """World vertices [m] (F, V, 3) float32; ``options`` by the names of ``drape.wire.options.DrapeOptions``."""
    return _draped(_read_vertices, garment, motion, body, options_document(options) | _STREAMED)


def drape_outfit(garments: Sequence[str], motion: Motion, body: Body, options: Options) -> Call[list[np.ndarray]]:
    """World vertices [m] (F, V, 3) float32 of each of ``garments``."""
    return _draped(_read_layers, garments, motion, body, options_document(options) | _STREAMED)


def drape_jets(garment: str | Sequence[str], motion: Motion, body: Body, options: Options) -> Call[list[JetFrame]]:
    """Posed patches of one garment, or of several over each other, frame by frame."""
    asked = options_document({**options, "geometry": "jets"}) | _STREAMED
    return _draped(_read_jets, garment, motion, body, asked)


def drape_glb(
    garment: str | Sequence[str],
    motion: Motion,
    body: Body,
    options: Options,
    *,
    with_body: bool = False,
    quantised: bool = True,
) -> Call[bytes]:
    """The bytes of an animated GLB."""
    asked = options_document(options) | {"body": with_body, "quantised": quantised}
    return _draped(_read_bytes, garment, motion, body, asked, accept=GLB)


def _draped(
    read: Callable[[httpx.Response], Answer],
    garment: str | Sequence[str],
    motion: Motion,
    body: Body,
    asked: dict[str, Any],
    *,
    accept: str = BINARY,
) -> Call[Answer]:
    clip, about = _motion(motion, body)
    return Call("POST", DRAPE, read, headers={"Accept": accept}, json=about | worn(garment) | asked, clip=clip)


def worn(garment: str | Sequence[str]) -> dict[str, Any]:
    """How a request names one garment, or several over each other."""
    return {"garment": garment} if isinstance(garment, str) else {"garments": list(garment)}


def posed_body(name: str, motion: Motion, body: Body) -> Call[np.ndarray]:
    """World vertices [m] (F, Vb, 3) float32 of the body ``name``."""
    clip, about = _motion(motion, body)
    path = f"/bodies/{_quoted(name)}/posed"
    return Call("POST", path, _read_vertices, headers={"Accept": BINARY}, json=about, clip=clip)


def _quoted(name: str) -> str:
    return quote(name, safe="")


def _motion(motion: Motion, body: Body) -> tuple[Clip, dict[str, Any]]:
    """The frames of a clip or of poses (F, 24, 3), and what JSON says of them; NaN is refused here."""
    fps, places = body.fps, body.trans
    poses = motion.poses if isinstance(motion, MotionClip) else motion
    if isinstance(motion, MotionClip):
        places = motion.trans if places is None else places
        fps = motion.fps if fps is None else fps
    about: dict[str, Any] = {"fps": DEFAULT_FPS if fps is None else float(fps)}
    if body.betas is not None:
        about["betas"] = _finite("betas", body.betas).tolist()
    return Clip(_finite("poses", poses), None if places is None else _finite("trans", places)), about


def _finite(key: str, array: np.ndarray) -> np.ndarray:
    numbers = np.asarray(array, dtype=np.float64)
    if not np.isfinite(numbers).all():
        raise MotionError(key, expected="finite numbers", got="NaN or infinity", cure="Remove these entries.")
    return numbers


def placed(clip: MotionClip, document: Mapping[str, Any]) -> MotionClip:
    """``clip``, a file's or a sample's, with the soles of the body in ``document`` on the ground."""
    return placed_on_ground(clip, np.array(document["joints"]), floor=document["floor_m"])


def _read_bytes(response: httpx.Response) -> bytes:
    return response.content


def _read_vertices(response: httpx.Response) -> np.ndarray:
    shape = (int(response.headers["X-Drape-Frames"]), int(response.headers["X-Drape-Vertices"]), 3)
    return np.frombuffer(response.content, dtype="<f4", count=math.prod(shape)).reshape(shape)


def _read_layers(response: httpx.Response) -> list[np.ndarray]:
    """The vertices of each garment; one garment has no header that counts its own."""
    vertices = _read_vertices(response)
    counts = [int(part.rpartition(":")[2]) for part in response.headers.get("X-Drape-Garments", "").split(",") if part]
    return np.split(vertices, np.cumsum(counts, dtype=int)[:-1], axis=1)


def _read_layout(response: httpx.Response) -> JetLayout:
    return unpack_layout(response.content)


def _read_jets(response: httpx.Response) -> list[JetFrame]:
    return split_jets(response.content)


def _read_clip(response: httpx.Response) -> MotionClip:
    document = response.json()
    return MotionClip(np.array(document["poses"]), np.array(document["trans"]), document["fps"], document["name"])
