"""Jets over REST: what a client needs of a garment once, and a clip as JETS messages."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from drape.errors import InputError, NotFound
from drape.wire.jets import message_bytes
from drape.wire.options import Resolution
from service.compute.drape_runtime import DrapeRuntime
from service.compute.garments import Outfit, Scene, layer_list
from service.compute.sliced_thread import SlicedThread
from service.errors import NotAcceptable, TooLarge
from service.guard.access import ClientHere
from service.guard.limits import check_answer
from service.http import negotiation
from service.http.answers import messages_answer
from service.http.openapi import responses
from service.stages.batch import Batch
from service.state import StateHere

router = APIRouter()


@router.get(
    "/garments/{garment_id}/jets",
    response_class=Response,
    responses=responses(InputError, NotFound, NotAcceptable, TooLarge, kinds=(negotiation.BINARY,)),
)
async def garment_jets(
    garment_id: str, request: Request, state: StateHere, client: ClientHere, resolution: Resolution = "delivered"
) -> Response:
    """What makes vertices of the garment's jets: a LAYOUT message (docs/reference/wire.md), constant per garment."""
    entry = await state.garment(garment_id, client)
    entry = entry.fine if resolution == "fine" else entry
    kind = negotiation.choose(request.headers.get("accept"), (negotiation.BINARY,))
    headers = {"X-Drape-Vertices": str(entry.vertex_count), "X-Drape-Patches": str(entry.patch_count)}
    return Response(entry.jet_layout, media_type=kind, headers=headers)


def check_jets_size(frames: int, scene: Scene, runtime: DrapeRuntime) -> None:
    """Refuses (``TooLarge``) an answer of JETS messages that would be too large."""
    patches = scene.patch_count
    check_answer(frames * message_bytes(patches), f"{frames} frames of {patches} patches", runtime.settings)


def jets_headers(frames: int, scene: Scene) -> dict[str, str]:
    """What an answer of so many JETS messages says of itself."""
    headers = {"X-Drape-Frames": str(frames), "X-Drape-Patches": str(scene.patch_count), "X-Drape-Origin": "root"}
    if isinstance(scene, Outfit):
        worn = layer_list(scene, patches=True)
        headers["X-Drape-Garments"] = ",".join(f"{layer['id']}:{layer['patches']}" for layer in worn)
    return headers


def jets_response(draped: Batch, headers: dict[str, str], sliced_thread: SlicedThread) -> Response:
    """The clip as one JETS message per frame; sequence and client time are the frame's number and time [s]."""
    scene = draped.plan.shown
    headers = headers | jets_headers(len(draped.messages), scene)
    headers["X-Drape-Left-M"] = f"{draped.quality.left_m.max():.6f}"
    return messages_answer(draped.messages, sliced_thread, headers)
