"""Requests and answers of clips, streams, garments, bodies and motions, and of the service's state."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from annotated_types import Len
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from drape.body.skeleton import JOINT_COUNT
from drape.files.gltf_json import MOST_NODES
from drape.graph.feeds import BETA_COUNT
from drape.stages.batch import ANGLE_LIMIT_RAD, BETA_LIMIT, PLACE_LIMIT_M
from drape.stages.placing import Origin
from drape.stages.tiers import Tier
from drape.wire.options import FIRST_ONLY, DrapeOptions, FabricNumbers, Identifier, TierName, WornGarments
from service.http.garment_schemas import SizeInfo

if TYPE_CHECKING:
    from drape.stages.scene import Entry
    from drape.stages.sizes import Sizes


def _number(limit: float) -> Any:
    """Returns the type of a finite number within ``limit``. Only the schema has the limit; ``drape.stages.batch``
    refuses numbers beyond it."""
    bounds: dict[str, Any] = {"minimum": -limit, "maximum": limit}
    return Annotated[float, Field(allow_inf_nan=False, strict=True, json_schema_extra=bounds)]


Angles = Annotated[list[_number(ANGLE_LIMIT_RAD)], Len(3, 3), FIRST_ONLY]
Place = Annotated[list[_number(PLACE_LIMIT_M)], Len(3, 3), FIRST_ONLY]
PoseRows = Annotated[list[Angles], Len(JOINT_COUNT, JOINT_COUNT), FIRST_ONLY]
Quaternion = Annotated[list[_number(1.01)], Len(4, 4), FIRST_ONLY]
RigRows = Annotated[list[Quaternion], Len(1, MOST_NODES), FIRST_ONLY]
Betas = Annotated[list[_number(BETA_LIMIT)], Len(0, BETA_COUNT), FIRST_ONLY]


class Request(BaseModel):
    """The base of requests. Unknown fields are refused, so that a typing mistake is not ignored."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class PosedOptions(Request):
    """The options of a body in motion, all but its poses: its shape, the frame rate, and the origin of positions."""

    betas: Betas | None = Field(default=None, description="The shape coefficients of the body. Left out: zeros.")
    fps: Annotated[float, Field(ge=0.001, le=1000.0, allow_inf_nan=False)] = Field(
        default=30.0, description="The number of frames per second."
    )
    origin: Origin = Field(
        default="world",
        description="The point that positions are relative to. world: the world's origin. root: each frame's root "
        "joint, whose position the answer holds in float64. Far from the world's origin only root keeps the "
        "garment's shape.",
    )


class PosedRequest(PosedOptions):
    """A body in motion: its poses, its root translations and its shape."""

    poses: Annotated[list[PoseRows], Len(1), FIRST_ONLY] = Field(
        description="The pose in each frame: for each of the 24 joints a rotation vector [rad] relative to the "
        "parent joint."
    )
    trans: Annotated[list[Place], FIRST_ONLY] | None = Field(
        default=None, description="The translation of the root [m] in each frame. Left out: zeros."
    )


class OnAvatar(BaseModel):
    """The options that name the body which wears the garments."""

    avatar: Identifier | None = Field(
        default=None,
        description="The id of an avatar (POST /avatars) that wears the garments. Left out: the standard body.",
    )
    alive: bool = Field(
        default=False,
        description="Whether the avatar also wears its own clothes as cloth (`alive` of GET /avatars/{id}), except "
        "those that the garments replace. No garment needs to be named then.",
    )


class ClipOptions(DrapeOptions, WornGarments, OnAvatar, PosedOptions):
    """The options of a clip of a garment, or of several worn over each other, on a body in motion: all but the
    poses."""

    body: bool = Field(default=False, description="Whether a GLB also has the body, as a skinned mesh. Not with rig.")
    rig: bool = Field(
        default=False,
        description="Whether a GLB of an avatar has the garments skinned to the nodes of the avatar's own file, with "
        "morph targets, in the unit of that file.",
    )
    joints: int | None = Field(
        default=None,
        ge=1,
        le=64,
        strict=True,
        description="With rig: the number of joints of its own that each garment gets in place of morph targets. "
        "They are children of the rig's joints and are fitted to the clip, so the GLB is small and only close to the "
        "drape.",
    )
    streamed: bool = Field(
        default=False,
        description="Whether the frames of a binary or PC2 answer are sent as soon as they are computed. The answer "
        "may then exceed the limit of its size, and has no headers with figures that are known only at the end.",
    )
    keep: bool = Field(
        default=False,
        description="Whether the service keeps the state of the cloth after the last frame for two minutes. The header "
        "X-Drape-Past names it.",
    )
    past: Annotated[str, Field(max_length=120)] | None = Field(
        default=None,
        description="The X-Drape-Past of the answer to the piece before this one, after whose last frame the clip "
        "goes on.",
    )
    quantised: bool = Field(
        default=True,
        description="Whether the garments of a GLB have positions of 16 bits and normals of 8 (KHR_mesh_quantization). "
        "With rig only the normals have fewer bits, with joints neither. false: float32.",
    )


class DrapeRequest(ClipOptions, PosedRequest):
    """The request of POST /drape: a garment, or several worn over each other, on a body in motion."""


class RigDrapeRequest(ClipOptions):
    """The request of POST /drape for an avatar in poses of its own rig."""

    avatar: Identifier = Field(description="The id of the avatar whose rig is posed.")
    rig_poses: Annotated[list[RigRows], Len(1), FIRST_ONLY] = Field(
        description="The pose in each frame: the local rotation of each of the avatar's nodes, as a quaternion x, y, "
        "z, w."
    )
    trans: Annotated[list[Place], FIRST_ONLY] | None = Field(
        default=None, description="The position of the pelvis's node [m] in each frame. Left out: its position at rest."
    )


class OpenRequest(DrapeOptions, WornGarments, OnAvatar, Request):
    """The message that opens a stream, or changes an open one."""

    type: Literal["open"]
    betas: Betas | None = Field(default=None, description="The shape coefficients of the body. Left out: zeros.")
    moves: bool = Field(
        default=False, description="Whether the client can take the stream's state to another process and go on there."
    )
    same: bool = Field(
        default=False, description="Whether the client takes a SAME message in place of a frame that it already shows."
    )


class Problem(BaseModel):
    """A refusal (RFC 9457): the name of what is wrong, what was expected, what came (`got`), and what cures it."""

    type: str
    title: str
    status: int
    detail: str = Field(description="One sentence made of name, expected, got and cure.")
    name: str
    expected: str
    got: str
    cure: str


class CardHealth(BaseModel):
    """The state of the graphics cards that compute folds, all together."""

    name: str
    fault: str = Field(description="Why cards are not used, a sentence for each. Empty while all of them are.")
    occupied: float = Field(description="The share of the memory that is used, 0 to 1.")
    busy: float = Field(description="The share of the time since the start in which launches ran, 0 to 1.")
    queue_s: float = Field(description="The age of the oldest frame that waits [s].")
    frames: int = Field(description="The number of frames computed since the start.")
    launches: int = Field(description="The number of kernel launches since the start.")
    frames_a_launch: float = Field(description="The mean number of frames in a launch.")


class Health(BaseModel):
    """The state of the service, with its model, provider and limits."""

    model_config = ConfigDict(protected_namespaces=())

    status: Literal["ok"]
    version: str
    model: str = Field(description="The name of the model.")
    model_digest: str
    dynamic: bool = Field(description="Whether the network has an encoder of motion, for inertia by the network.")
    provider: str = Field(description="What computes the network: the processor or a GPU.")
    compiled: bool = Field(description="Whether the product's own engine computes the network, and not ONNX Runtime.")
    elsewhere: int = Field(
        description="The number of operations that do not run on the provider. On a GPU each of them waits for a copy."
    )
    device_bytes: int = Field(description="The bytes that the garments' constants take on the device that computes.")
    card: CardHealth | None = Field(description="The graphics cards that compute folds. Null without the extra cuda.")
    body: str = Field(description="The id of the standard body.")
    garments: int = Field(description="The number of garments in service.")
    passes: int = Field(
        description="The most corrections of the network that a request may ask for. 0: there is no choice."
    )
    fabrics: bool = Field(description="Whether the network reads a garment's fabric.")
    layers: int = Field(description="The most garments of an outfit.")
    max_frames: int = Field(description="The most frames of a request. Longer clips are sent in pieces.")
    max_body_bytes: int = Field(description="The most bytes of a request's body.")
    sessions: int = Field(description="The number of open streams.")
    refused_garments: list[str] = Field(
        description="The stored garments that could not be loaded: the file's name and the reason of each."
    )


class FabricInfo(FabricNumbers):
    """A fabric that a request may name, with its numbers and their source."""

    id: str
    thickness_m: float
    friction: float = Field(description="The coefficient of friction on skin and cloth.")
    source: str = Field(description="Where the numbers come from.")


class TierInfo(BaseModel):
    """A tier: how many corrections the network makes and how many steps of folds follow."""

    id: TierName
    default: bool = Field(description="Whether a request that names no tier gets this one.")
    passes: int = Field(description="The number of corrections of the network.")
    folds: int = Field(description="The number of steps of folds.")
    coarse: bool = Field(
        description="Whether a coarse cloth takes the steps of folds. With folds 0 it takes one step, which eases the "
        "stretch of the network's drape."
    )
    alone: int = Field(description="The number of corrections of a drape without folds: of jets, or with folds 0.")
    figures: dict[str, Any] = Field(
        description="The figures that benchmarks.tradeoff measured of this tier, and the machine on which it did."
    )

    @classmethod
    def of(cls, tier: Tier, pass_count: int, *, default: TierName) -> TierInfo:
        """Returns the answer about ``tier`` of a model with at most ``pass_count`` corrections. ``default`` is the name
        of the tier of requests that name none."""
        passes, alone = (min(pass_count, pass_count if p is None else p) for p in (tier.passes, tier.alone))
        named = TypeAdapter(TierName).validate_python(tier.name)
        return cls(
            id=named,
            default=named == default,
            passes=passes,
            folds=tier.folds,
            coarse=tier.coarse,
            alone=alone,
            figures=dict(tier.figures),
        )


class GarmentInfo(BaseModel):
    """A garment that can be draped."""

    id: str
    name: str
    digest: str
    vertices: int
    faces: int
    fine_vertices: int = Field(
        description="The number of vertices of the mesh of resolution fine. It equals "
        "vertices where the delivered mesh is fine enough."
    )
    hung: bool = Field(
        default=False,
        description="Whether the drawn mesh hangs on a cloth with triangles of its own, that of resolution fine.",
    )
    patches: int
    source: Literal["shipped", "user"]
    published: bool = Field(description="Whether other keys than its owner's may use it.")
    materials: list[str] = Field(description="The names of the materials.")
    fabric: str | dict[str, Any] = Field(
        description="The fabric of the garment where a request names no other: its name or its numbers."
    )
    sizes: list[SizeInfo] = Field(description="The sizes of the garment, the smallest first. Empty if it has one size.")
    manifest: dict[str, Any] = Field(description="The manifest of the garment's cache.")

    @staticmethod
    def of(entry: Entry, sizes: Sizes) -> GarmentInfo:
        """Returns the answer about the garment ``entry``, whose sizes are those in ``sizes``."""
        garment = entry.garment
        return GarmentInfo(
            id=entry.id,
            name=entry.name,
            digest=garment.digest,
            vertices=entry.vertex_count,
            faces=len(garment.surface.faces),
            fine_vertices=len(garment.vertices),
            hung=garment.drawn is not None and not garment.carriers,
            patches=garment.patch_count,
            source=entry.source,
            published=entry.owner is None or entry.published,
            materials=list(garment.surface.material_names),
            fabric=garment.fabric if isinstance(garment.fabric, str) else dict(garment.fabric),
            sizes=[
                SizeInfo(size=size, cut_for=sizes.cut_for(entry, size), **measures)
                for size, measures in sizes.measures(entry).items()
            ],
            manifest=garment.manifest,
        )


class BodyInfo(BaseModel):
    """A body on which garments are draped."""

    id: str
    digest: str
    vertices: int
    faces: int
    shapes: int = Field(description="The number of its shape coefficients.")


class BodyDocument(BodyInfo):
    """A body in one shape."""

    joints: list[list[float]] = Field(description="The positions of the 24 joints at rest [m].")
    floor_m: float = Field(description="The height of the soles at rest [m], by which a clip is placed on the ground.")


class MotionInfo(BaseModel):
    """A sample clip."""

    id: str
    name: str
    frames: int
    fps: float


class MotionDocument(MotionInfo):
    """A sample clip with its poses and translations, as POST /drape takes them."""

    poses: list[list[list[float]]] = Field(
        description="In each frame, for each of the 24 joints, a rotation vector [rad] relative to the parent joint."
    )
    trans: list[list[float]] = Field(description="The translation of the root in each frame [m].")


class MeshDocument(BaseModel):
    """A mesh at rest, in the coordinates of the body at rest."""

    id: str
    vertices: list[list[float]] = Field(description="The positions of the vertices [m].")
    faces: list[list[int]] = Field(description="The triangles: three indices of vertices each.")
    uv: list[list[float]] = Field(description="The texture coordinates. Empty if the file has none.")
    uv_faces: list[list[int]] = Field(description="The triangles as indices of texture coordinates.")
    materials: list[str] = Field(description="The names of the materials.")
    face_material: list[int] = Field(description="The index of each triangle's material.")


class LayerInfo(BaseModel):
    """One garment of an outfit."""

    id: str
    vertices: int = Field(description="The number of its vertices.")


class VerticesDocument(BaseModel):
    """The positions of vertices in each frame, in the world's axes."""

    fps: float
    frames: int
    vertices: int
    origin: Origin = Field(
        description="The point that positions are relative to: the world's origin, or each frame's root joint."
    )
    roots: list[list[float]] | None = Field(
        default=None, description="With origin root: the position of the root joint in each frame [m], float64."
    )
    garments: list[LayerInfo] | None = Field(
        default=None, description="The garments of an outfit, in the order of their vertices."
    )
    positions: list[list[list[float]]] = Field(description="The position of each vertex in each frame [m].")
