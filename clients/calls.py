"""Requests of a client, made of clips and options, and readers of their answers."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, TypeVar
from urllib.parse import quote

import httpx
import numpy as np

from clients.refusals import refusal
from drape.errors import InputError, MotionError
from drape.files.avatar_table import entry_for
from drape.files.formats import AVATAR_SUFFIXES, MESH_SUFFIXES
from drape.motion.clip import MotionClip
from drape.motion.grounding import place_on_ground
from drape.wire.clip_message import check_motion, pack_clip
from drape.wire.jets import JetFrame, split_jets
from drape.wire.layout import JetLayout, unpack_layout
from drape.wire.options import options_document

Answer = TypeVar("Answer")
Motion = MotionClip | np.ndarray
Options = Mapping[str, Any]
Size = str | Sequence[str | None] | None  # one size for all garments, or one for each

BINARY, GLB = "application/octet-stream", "model/gltf-binary"
DEFAULT_URL = "http://127.0.0.1:8000"
DEFAULT_FPS = 30.0
DRAPE = "/drape"
WORN = ("avatar", "alive", "size")  # options beside those of ``DrapeOptions``: who wears what
STREAMED: Options = {"streamed": True}  # so that the answer may be of any length


@dataclass(frozen=True, eq=False)
class BodyShape:
    """The body of a request: translations ``trans`` [m] (F, 3) in place of the clip's own, shape coefficients ``betas``
    (S,), and frames a second. None leaves each to the clip or to the service."""

    trans: np.ndarray | None = None
    betas: np.ndarray | None = None
    fps: float | None = None


@dataclass(frozen=True, eq=False)
class PoseClip:
    """The frames of a request: ``poses`` (F, 24, 3) [rad], or local quaternions (F, N, 4), x, y, z, w, of the nodes of
    an avatar's own rig, and ``trans`` (F, 3) [m], None for zeros.

    Refuses (``MotionError``) other shapes.
    """

    poses: np.ndarray
    trans: np.ndarray | None

    def __post_init__(self) -> None:
        check_motion(self.poses, self.trans)

    def part(self, rows: slice) -> PoseClip:
        """Returns a clip of the frames ``rows`` alone."""
        return PoseClip(self.poses[rows], None if self.trans is None else self.trans[rows])


@dataclass(frozen=True)
class Call(Generic[Answer]):
    """One request, and ``read``, which makes the answer of the response. With a ``clip`` the body is a CLIP message of
    its frames and of ``json``."""

    method: str
    path: str
    read: Callable[[httpx.Response], Answer]
    params: Mapping[str, str] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    json: Any = None
    content: bytes | None = None
    clip: PoseClip | None = None

    def arguments(self) -> dict[str, Any]:
        """Returns the arguments of httpx's ``request`` by name."""
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
        """Returns what ``read`` makes of ``response``; raises the service's refusal (``DrapeError``) if it is one."""
        if response.is_success:
            return self.read(response)
        raise refusal(response)


def key_headers(key: str | None) -> dict[str, str]:
    """Returns the HTTP header that carries an API ``key`` or a ticket; none for None."""
    return {} if key is None else {"Authorization": f"Bearer {key}"}


def get_call(
    *names: str,
    read: Callable[[httpx.Response], Any] = httpx.Response.json,
    accept: str = "application/json",
    betas: np.ndarray | None = None,
    **params: str,
) -> Call[Any]:
    """Returns the call that GETs the path of ``names`` with the query ``params``, and with ``betas`` (S,), the shape of
    the body, if they are given. ``read`` makes the answer of the response."""
    if betas is not None:
        params["betas"] = ",".join(repr(float(beta)) for beta in betas)
    return Call("GET", url_path(*names), read, params, {"Accept": accept})


def post_call(document: Mapping[str, Any], *names: str) -> Call[dict[str, Any]]:
    """Returns the call that POSTs ``document``, without the fields that are None, to the path of ``names``. The answer
    is the parsed JSON."""
    given = {name: value for name, value in document.items() if value is not None}
    return Call("POST", url_path(*names), httpx.Response.json, headers={"Accept": "application/json"}, json=given)


def url_path(*names: str) -> str:
    """Returns the path of an address made of ``names``, such as "/garments/tshirt"; special characters are escaped."""
    return "".join(f"/{quote(name, safe='')}" for name in names)


def _says_itself(entry: Any) -> bool:
    """Whether the service understands a table's entry by itself: an object or ``standard``, not a mesh file."""
    return isinstance(entry, dict) or entry == "standard"


def upload_avatar_call(path: Path, name: str | None, alive: bool) -> Call[dict[str, Any]]:
    """Returns the call that sends the character file at ``path`` under ``name``, by default the file's; its answer is
    the upload's job. With ``alive`` its own clothes become garments. Refuses (``InputError``) other suffixes and a file
    that cannot be read."""
    if path.suffix.lower() not in AVATAR_SUFFIXES:
        expected, got = f"one of {', '.join(AVATAR_SUFFIXES)}", path.suffix or "no suffix"
        raise InputError(path.name, expected=expected, got=got, cure="Export the character so.")
    params = {"name": (name or path.stem) + path.suffix.lower()} | ({"alive": "true"} if alive else {})
    headers = {"Content-Type": BINARY}
    return Call("POST", "/avatars", httpx.Response.json, params=params, content=_content(path), headers=headers)


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(
            str(path), expected="a file that can be read", got=str(error.strerror), cure="Check the path."
        ) from error


def upload_call(path: Path, avatar: str | dict[str, Any] | None, name: str | None) -> Call[dict[str, Any]]:
    """Returns the call that sends the garment file at ``path`` under ``name``, by default the file's; its answer is the
    upload's job.

    ``avatar``: the body that it was modelled on. None takes the one that ``avatars.json`` beside the file has for it,
    unless that is a mesh file. Refuses (``InputError``) other suffixes and a file that cannot be read.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(
            path.name,
            expected=f"one of {', '.join(MESH_SUFFIXES)}",
            got=path.suffix or "no suffix",
            cure="Export the mesh so.",
        )
    content = _content(path)
    params = {"name": (name or path.stem) + path.suffix.lower()}
    if avatar is None:
        # The service cannot see the folder that the file lies in.
        row = entry_for(path.name, [path.parent])
        avatar = row[1] if row is not None and _says_itself(row[1]) else None
    if avatar is not None:
        params["avatar"] = json.dumps(avatar) if isinstance(avatar, dict) else avatar
    return Call(
        "POST", "/garments", httpx.Response.json, params=params, content=content, headers={"Content-Type": BINARY}
    )


def drape_call(
    read: Callable[[httpx.Response], Answer],
    garment: str | Sequence[str],
    motion: Motion,
    body: BodyShape,
    options: Options,
    *,
    accept: str = BINARY,
    more: Options = STREAMED,
) -> Call[Answer]:
    """Returns the call that drapes ``garment``, or several, over ``motion``; ``read`` makes the answer of the response,
    which has the media type ``accept``. ``options`` are named as the fields of ``drape.wire.options.DrapeOptions``,
    besides "avatar", "alive" and "size"; ``more`` are fields by their names on the wire."""
    clip, about = motion_of(motion, body)
    fields = {**about, **worn_fields(garment, options), **options_document(_without(options, *WORN)), **more}
    return Call("POST", DRAPE, read, headers={"Accept": accept}, json=fields, clip=clip)


def _without(options: Options, *names: str) -> Options:
    return {key: value for key, value in options.items() if key not in names}


def at_root(call: Call[np.ndarray]) -> Call[tuple[np.ndarray, np.ndarray]]:
    """Returns a call like ``call`` whose answer is the vertices [m] (F, V, 3) float32 relative to the roots, and the
    roots [m] (F, 3) float64 in the world."""

    def read(response: httpx.Response) -> tuple[np.ndarray, np.ndarray]:
        vertices = call.read(response)
        return vertices, np.frombuffer(response.content, dtype="<f8", offset=vertices.nbytes).reshape(-1, 3)

    return Call(call.method, call.path, read, headers=call.headers, json=call.json | {"origin": "root"}, clip=call.clip)


def worn_fields(garment: str | Sequence[str], options: Options = MappingProxyType({})) -> dict[str, Any]:
    """Returns the JSON fields of a request that say what is worn: "garment" for one, "garments" for several over each
    other, neither for none; and "avatar", "alive" and "size" of ``options``."""
    named = {"garment": garment} if isinstance(garment, str) else {"garments": list(garment)} if garment else {}
    return named | {name: options[name] for name in WORN if options.get(name) not in (None, False)}


def name_sizes(garments: Sequence[str], size: Size) -> list[tuple[str, str | None]]:
    """Returns each of ``garments`` with its size, None for M; ``size`` is one for all, or a list with one for each."""
    sizes = [size] * len(garments) if size is None or isinstance(size, str) else size
    return list(zip(garments, sizes, strict=True))


def motion_of(motion: Motion, body: BodyShape) -> tuple[PoseClip, dict[str, Any]]:
    """Returns the frames of ``motion``, which is a clip, poses (F, 24, 3) [rad] or quaternions (F, N, 4) of a rig, and
    the JSON fields "fps" and "betas" of the request. Refuses (``MotionError``) NaN, infinity and other shapes."""
    fps, places = body.fps, body.trans
    poses = motion.poses if isinstance(motion, MotionClip) else motion
    if isinstance(motion, MotionClip):
        places = motion.trans if places is None else places
        fps = motion.fps if fps is None else fps
    about: dict[str, Any] = {"fps": DEFAULT_FPS if fps is None else float(fps)}
    if body.betas is not None:
        about["betas"] = _finite("betas", body.betas).tolist()
    return PoseClip(_finite("poses", poses), None if places is None else _finite("trans", places)), about


def _finite(key: str, array: np.ndarray) -> np.ndarray:
    numbers = np.asarray(array, dtype=np.float64)
    if not np.isfinite(numbers).all():
        raise MotionError(key, expected="finite numbers", got="NaN or infinity", cure="Remove these entries.")
    return numbers


def place_clip(clip: MotionClip, document: Mapping[str, Any]) -> MotionClip:
    """Returns ``clip`` moved so that the soles of the body stand on the ground (``place_on_ground``). ``document`` has
    the body's rest "joints" [m] and its "floor_m", the height of its soles [m]."""
    return place_on_ground(clip, np.array(document["joints"]), floor=document["floor_m"])


def read_bytes(response: httpx.Response) -> bytes:
    """Returns the bytes of the answer as they came."""
    return response.content


def read_vertices(response: httpx.Response) -> np.ndarray:
    """Returns the vertices [m] (F, V, 3) float32 of all garments in the world, one garment after the other."""
    shape = (int(response.headers["X-Drape-Frames"]), int(response.headers["X-Drape-Vertices"]), 3)
    return np.frombuffer(response.content, dtype="<f4", count=math.prod(shape)).reshape(shape)


def read_clip_layers(response: httpx.Response) -> list[np.ndarray]:
    """Returns the vertices [m] (F, V, 3) float32 of each garment in the world, the innermost first."""
    vertices = read_vertices(response)
    # A single garment has no header that counts vertices.
    counts = [int(part.rpartition(":")[2]) for part in response.headers.get("X-Drape-Garments", "").split(",") if part]
    return np.split(vertices, np.cumsum(counts, dtype=int)[:-1], axis=1)


def read_layout(response: httpx.Response) -> JetLayout:
    """Returns the layout by which a client makes vertices of a garment's jets."""
    return unpack_layout(response.content)


def read_jets(response: httpx.Response) -> list[JetFrame]:
    """Returns the posed patches of each frame."""
    return split_jets(response.content)


def read_clip(response: httpx.Response) -> MotionClip:
    """Returns a sample clip: poses (F, 24, 3) [rad] and translations (F, 3) [m]."""
    document = response.json()
    return MotionClip(np.array(document["poses"]), np.array(document["trans"]), document["fps"], document["name"])
