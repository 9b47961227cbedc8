"""Routes for the state of the service, for fabrics, tiers, bodies and sample clips, and for tickets."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, Field

from drape.body.model import BodyModel
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import FABRICS
from drape.errors import BodyError, InputError, NotFound, Unavailable
from drape.export.glb_body import add_body, heaviest_bones
from drape.export.glb_file import GlbFile
from drape.wire.mesh_messages import pack_body_mesh
from drape.wire.messages import WIRE_VERSION
from service.errors import Forbidden, NotAcceptable, Unauthorized
from service.guard.tickets import LIFE_S
from service.http import schemas
from service.http.answers import BINARY, GLB, JSON, choose, file_answer, json_answer, json_pieces
from service.http.kept import ASKED_AGAIN, packed_text
from service.http.openapi import EVERYWHERE, KNOWN, responses
from service.http.query import Betas, queried_shape
from service.state import ADMITTED, ClientHere, StateHere
from service.watch.probes import PATHS, probe_answer
from service.watch.prometheus import MEDIA_TYPE

if TYPE_CHECKING:
    from drape.live.card_lanes import Lanes
    from service.watch.probes import Lifecycle
    from service.watch.prometheus import Metrics

router = APIRouter()


@router.get("/health")
async def health(request: Request, state: StateHere) -> schemas.Health:
    """Returns the state of the service: its model, provider, card and limits. An answer means that it works."""
    runtime = state.runtime
    return schemas.Health(
        status="ok",
        version=request.app.version,
        model=runtime.engine.manifest.name,
        model_digest=runtime.engine.manifest.digest,
        dynamic=runtime.engine.dynamic,
        provider=runtime.engine.provider,
        compiled=runtime.engine.compiled is not None,
        elsewhere=runtime.engine.nodes_off_provider,
        device_bytes=runtime.device_bytes,
        card=card_health(runtime.lane),
        body=runtime.body.name,
        garments=len(runtime.garments.entries()),
        passes=runtime.engine.pass_count,
        fabrics=runtime.engine.knows_fabrics,
        layers=runtime.settings.max_layers,
        max_frames=runtime.settings.max_frames,
        max_body_bytes=runtime.settings.max_body_bytes,
        sessions=state.streams.count,
        refused_garments=runtime.garments.refused,
    )


def card_health(lane: Lanes | None) -> schemas.CardHealth | None:
    """Returns the state of the cards of ``lane`` together; None without any."""
    if lane is None:
        return None
    report = lane.report()
    numbers = {name: getattr(report, name) for name in schemas.CardHealth.model_fields if name != "name"}
    return schemas.CardHealth(name=report.card, **numbers)


@router.get("/fabrics")
async def fabrics() -> list[schemas.FabricInfo]:
    """Lists the fabrics that a request may name, with their numbers and sources."""
    return [schemas.FabricInfo.model_validate({"id": name, **_public(cloth)}) for name, cloth in FABRICS.items()]


def _public(cloth: Fabric) -> dict[str, Any]:
    return {name: getattr(cloth, name) for name in schemas.FabricInfo.model_fields if name != "id"}


@router.get("/tiers")
async def tiers(state: StateHere) -> list[schemas.TierInfo]:
    """Lists the tiers that a request may name, the one that computes least first, with figures that were measured of
    each.
    """
    runtime = state.runtime
    default = runtime.settings.tier
    return [schemas.TierInfo.of(tier, runtime.engine.pass_count, default=default) for tier in runtime.tiers]


@router.get("/bodies")
async def bodies(state: StateHere) -> list[schemas.BodyInfo]:
    """Lists the bodies of this service. There is one: the body that the model was trained on."""
    return [_body_info(state.runtime.body)]


def _body_info(body: BodyModel) -> schemas.BodyInfo:
    return schemas.BodyInfo(
        id=body.name, digest=body.digest, vertices=body.vertex_count, faces=len(body.faces), shapes=body.shape_count
    )


@router.get("/bodies/{body_id}", responses=responses(InputError, NotFound, BodyError))
async def body(body_id: str, state: StateHere, betas: Betas = None) -> schemas.BodyDocument:
    """Returns the body in the shape ``betas``: its joints at rest and the height of its soles."""
    runtime = state.runtime
    runtime.check_body_id(body_id)
    shape = queried_shape(betas, runtime.body)
    return schemas.BodyDocument(
        **_body_info(runtime.body).model_dump(),
        joints=runtime.body.rest_joints(shape).tolist(),
        floor_m=runtime.body.floor_m(shape),
    )


@router.get(
    "/bodies/{body_id}/mesh",
    response_model=schemas.MeshDocument,
    responses=responses(InputError, NotFound, NotAcceptable, BodyError, kinds=(GLB, BINARY)) | KNOWN,
)
async def body_mesh(body_id: str, request: Request, state: StateHere, betas: Betas = None) -> Response:
    """Returns the mesh [m] of the body at rest in the shape ``betas``. The Accept header chooses JSON, a GLB or a BODY
    message (docs/reference/wire.md); the latter two have the 24 joints as a skeleton.
    """
    runtime = state.runtime
    runtime.check_body_id(body_id)
    shape = queried_shape(betas, runtime.body)
    kind = choose(request.headers.get("accept"), (JSON, GLB, BINARY))
    if kind == BINARY:
        make = partial(runtime.threads.apart, _body_message, runtime.body, shape)
        body_of = f"body {WIRE_VERSION} {runtime.body.digest}".encode() + shape.tobytes()
        return await state.meshes.answer(body_of, make, request_headers=request.headers, kind=kind, cache=ASKED_AGAIN)
    if kind == GLB:
        file = GlbFile()
        add_body(file, runtime.body, shape)
        return file_answer(file, file.head(), state.sliced_thread, {})
    faces = runtime.body.faces
    vertices = runtime.body.rest_vertices(shape).astype(np.float32)
    document = {"id": runtime.body.name, "vertices": vertices, "faces": faces, "uv": [], "uv_faces": []}
    return json_answer(
        document | {"materials": ["body"], "face_material": np.zeros(len(faces), int)}, state.sliced_thread
    )


def _body_message(body: BodyModel, shape: np.ndarray) -> bytes:
    rest, joints = body.rest_vertices(shape), body.rest_joints(shape)
    return packed_text(pack_body_mesh(rest, body.faces, joints, *heaviest_bones(body)))


@router.get("/motions")
async def motions(state: StateHere) -> list[schemas.MotionInfo]:
    """Lists the sample clips of the service."""
    clips = {key: state.runtime.motions.get(key) for key in state.runtime.motions.ids()}
    return [
        schemas.MotionInfo(id=key, name=clip.name, frames=clip.frame_count, fps=clip.fps) for key, clip in clips.items()
    ]


@router.get(
    "/motions/{motion_id}",
    response_model=schemas.MotionDocument,
    responses=responses(InputError, NotFound, BodyError) | KNOWN,
)
async def motion(
    motion_id: str,
    request: Request,
    state: StateHere,
    client: ClientHere,
    betas: Betas = None,
    avatar: Annotated[
        str | None,
        Query(
            max_length=120, description="The id of the avatar that the clip is placed for. Left out: the standard body."
        ),
    ] = None,
) -> Response:
    """Returns one sample clip with its poses [rad] and translations [m]. The translations put the soles of the body in
    the shape ``betas``, or of the avatar, on the ground.
    """
    runtime, body = state.runtime, state.runtime.body
    if avatar is not None:
        body = (await state.wearer(avatar, client)).body
    clip, shape = runtime.motions.get(motion_id), queried_shape(betas, body)

    def write() -> bytes:
        placed = runtime.motions.placed(motion_id, body, shape)
        document = {"id": motion_id, "name": clip.name, "frames": clip.frame_count, "fps": clip.fps}
        document |= {"poses": np.round(placed.poses, 6), "trans": np.round(placed.trans, 6)}
        return packed_text(b"".join(json_pieces(document)))

    motion_of = f"motion {motion_id} {body.digest}".encode() + shape.tobytes() + clip.poses.tobytes()
    make = partial(runtime.threads.apart, write)
    return await state.meshes.answer(motion_of, make, request_headers=request.headers, kind=JSON, cache=ASKED_AGAIN)


class Ticket(BaseModel):
    """A ticket that stands for an API key."""

    ticket: str
    expires_s: float = Field(description="For how many seconds the ticket is valid.")


@router.post("/tickets", responses=responses(InputError))
async def make_ticket(request: Request, state: StateHere, client: ClientHere) -> Ticket:
    """Makes a ticket that stands for the key of this request for a minute, for pages that must not hold the key."""
    if client.name is None:
        cure = "Send requests without a ticket: this service asks for no key."
        raise InputError("ticket", expected="a service with keys", got="one without", cure=cure)
    if "." in request.headers.get("authorization", ""):
        raise Unauthorized("key", expected="an API key", got="a ticket", cure="Send the key to make a ticket.")
    return Ticket(ticket=state.access.tickets.make(client.name), expires_s=LIFE_S)


def probe_routes(lifecycle: Lifecycle, metrics: Metrics) -> APIRouter:
    """Returns the routes ``/livez`` and ``/readyz``, which need no key, and ``/metrics``, which needs one if there are
    keys."""
    probes = APIRouter()

    async def probe(request: Request) -> Response:
        if request.url.path == "/metrics":
            rendered = request.app.state.drape.sliced_thread.run_pieces(metrics.pieces())
            return Response(b"".join([piece async for piece in rendered]), media_type=MEDIA_TYPE)
        status, kind, content = probe_answer(request.url.path, lifecycle, metrics)
        return Response(content, status, media_type=kind)

    described = {
        "/livez": "Answers 200 while the process lives, and 503 when it should be replaced.",
        "/readyz": "Answers 200 while the service takes work, and 503 while it loads or drains.",
        "/metrics": "Returns the metrics of the service in the text format of Prometheus.",
    }
    for path in PATHS:
        series = path == "/metrics"
        asks = ADMITTED if series else ()
        refusals, kind = (EVERYWHERE, "text/plain") if series else ((Forbidden, Unavailable), JSON)
        probes.add_api_route(
            path,
            probe,
            description=described[path],
            response_class=Response,
            name=path[1:],
            dependencies=asks,
            responses=responses(*refusals, kinds=(kind,)),
        )
    return probes
