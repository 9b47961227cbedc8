"""The route that reads motion files of all kinds."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from drape.errors import InputError, MotionError, TooLarge
from drape.motion.readers import MOTION_SUFFIXES
from service.compute.garments import slug
from service.errors import TooSlow
from service.http.answers import BINARY
from service.http.openapi import BYTES, responses
from service.http.problems import check_query
from service.state import ClientHere, StateHere

router = APIRouter()
KINDS = (BINARY, "model/gltf-binary", "model/vrm", "model/fbx")


@router.post(
    "/motions",
    response_class=Response,
    openapi_extra={"requestBody": {"content": {kind: {"schema": BYTES} for kind in KINDS}, "required": True}},
    responses=responses(InputError, MotionError, TooSlow, TooLarge, kinds=(BINARY,)),
)
async def read_motion(
    request: Request,
    state: StateHere,
    client: ClientHere,
    name: Annotated[str, Query(max_length=120, description="The name of the file, whose suffix says its kind.")],
    clip: Annotated[
        str | None, Query(min_length=1, max_length=120, description="The animation to read. Left out: the longest.")
    ] = None,
) -> Response:
    """Reads a motion file. The body of the request is its raw bytes: BVH, GLB, glTF, VRM, VRMA, FBX or npz. The answer
    is an npz of a clip, y up: poses (frames, 24, 3) [rad], trans (frames, 3) [m], and mocap_framerate. The service does
    not keep the file.
    """
    check_query(request.query_params, ("name", "clip"))
    path = PurePosixPath(name)
    if path.suffix.lower() not in MOTION_SUFFIXES:
        expected = f"the name of a motion file: {', '.join(MOTION_SUFFIXES)}"
        raise InputError("name", expected=expected, got=name, cure="Give ?name=dance.fbx.")
    file = f"{slug(path.stem)}{path.suffix.lower()}"
    with state.access.using(client, "clips"):
        content = await state.motion_files.read(file, request.stream(), clip)
    return Response(content, media_type=BINARY)
