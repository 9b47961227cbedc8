"""The Python client of the stream: poses in, frames out, each with its age.

    async with await DrapeStream.open("http://127.0.0.1:8000", "tshirt") as stream:  # or ["trousers", "tshirt"]
        await stream.send(pose, trans)
        received = await stream.receive()
        received.frame.vertices(), received.age_s

    async with await DrapeStream.open(url, "tshirt", geometry="jets") as stream:
        await stream.send(pose, trans)
        layout.vertices((await stream.receive_jets()).frame)  # layout: DrapeClient.jet_layout("tshirt")

Frames answer the newest pose; poses that a newer one replaced are counted in ``frame.dropped``.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidURI
from websockets.typing import Subprotocol

from clients.calls import DEFAULT_URL, ServiceError, key_headers, problem_error, unreachable, worn
from drape.errors import DrapeError
from drape.wire import messages as wire
from drape.wire.jets import JetFrame, unpack_jets
from drape.wire.options import options_document

MESSAGE_LIMIT_BYTES = 16 * 2**20
OPEN_S = 10.0


@dataclass(frozen=True, eq=False)
class Received:
    """A frame and the time [s] since its pose was sent, by this machine's clock."""

    frame: wire.Frame
    age_s: float


@dataclass(frozen=True, eq=False)
class ReceivedJets:
    """A frame of posed patches and the time [s] since its pose was sent, by this machine's clock."""

    frame: JetFrame
    age_s: float


class DrapeStream:
    """An open stream of one garment or outfit. ``about`` is the service's answer to the opening."""

    def __init__(self, connection: ClientConnection, about: dict[str, Any]) -> None:
        self._connection = connection
        self._sequence = 0
        self.about = about

    @classmethod
    async def open(
        cls,
        url: str = DEFAULT_URL,
        garment: str | Sequence[str] = "",
        *,
        betas: Sequence[float] | np.ndarray | None = None,
        key: str | None = None,
        **options: Any,
    ) -> DrapeStream:
        """Connects and opens, with ``options`` of ``drape.wire.options.DrapeOptions``; raises the service's refusal.

        ``key``: an API key or a ticket, where the service has keys.
        """
        address = url.rstrip("/").replace("http", "ws", 1) + "/stream"
        try:
            connection = await connect(
                address,
                subprotocols=[Subprotocol(wire.SUBPROTOCOL)],
                additional_headers=key_headers(key),
                compression=None,
                max_size=MESSAGE_LIMIT_BYTES,
                open_timeout=OPEN_S,
            )
        except (OSError, TimeoutError, InvalidHandshake, InvalidURI) as error:
            raise unreachable(address, error) from error
        stream = cls(connection, {})
        try:
            stream.about = await stream.reopen(garment, betas=betas, **options)
        except BaseException:
            await connection.close()
            raise
        return stream

    async def __aenter__(self) -> DrapeStream:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Ends the stream."""
        await self._connection.close()

    async def reopen(
        self,
        garment: str | Sequence[str],
        *,
        betas: Sequence[float] | np.ndarray | None = None,
        **options: Any,
    ) -> dict[str, Any]:
        """Turns the stream to another garment, shape or ``options``; old frames are thrown away.

        Several garments are worn over each other, the innermost first; ``layers`` parts their vertices. With jets
        frames come from ``receive_jets``.
        """
        shape = None if betas is None else [float(beta) for beta in betas]
        request = {"type": "open", **worn(garment), "betas": shape, **options_document(options)}
        await self._transmit(json.dumps(request))
        while True:
            message = await self._message()
            if isinstance(message, str):
                self.about = json.loads(message)
                return self.about

    def layers(self, vertices: np.ndarray) -> list[np.ndarray]:
        """The ``vertices`` (V, 3) of a frame by garment; all of them where there is one."""
        counts = [layer["vertices"] for layer in self.about.get("garments", ())]
        return np.split(vertices, np.cumsum(counts, dtype=int)[:-1])

    async def send(self, pose: np.ndarray, trans: np.ndarray | None = None) -> int:
        """Sends a pose (24, 3) [rad] with its root translation (3,) [m]; returns its sequence number."""
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        place = np.zeros(3) if trans is None else np.asarray(trans)
        message = wire.Pose(self._sequence, time.perf_counter(), place, np.asarray(pose))
        await self._transmit(wire.pack_pose(message))
        return self._sequence

    async def receive(self) -> Received:
        """The next frame, acknowledged."""
        frame = wire.unpack_frame(await self._binary())
        await self._transmit(wire.pack_ack(frame.sequence))
        return Received(frame, time.perf_counter() - frame.client_time_s)

    async def receive_jets(self) -> ReceivedJets:
        """The next frame of a stream of jets, acknowledged; ``frame.layers`` parts it by garment."""
        frame = unpack_jets(await self._binary())
        await self._transmit(wire.pack_ack(frame.sequence))
        return ReceivedJets(frame, time.perf_counter() - frame.client_time_s)

    async def _binary(self) -> bytes:
        while True:
            message = await self._message()
            if isinstance(message, bytes):
                return message

    async def _transmit(self, message: str | bytes) -> None:
        try:
            await self._connection.send(message)
        except ConnectionClosed as error:
            raise await self._reason(error) from error

    async def _message(self) -> str | bytes:
        try:
            message = await self._connection.recv()
        except ConnectionClosed as error:
            raise await self._reason(error) from error
        if isinstance(message, str):
            said = json.loads(message)
            if said.get("type") == "error":
                raise problem_error(said)
        return message

    async def _reason(self, error: ConnectionClosed) -> DrapeError:
        """The service's sentence where one came before the close; the close code otherwise."""
        while True:
            try:
                message = await asyncio.wait_for(self._connection.recv(), 1.0)
            except (ConnectionClosed, TimeoutError):
                break
            if isinstance(message, str) and json.loads(message).get("type") == "error":
                return problem_error(json.loads(message))
        close = error.rcvd
        got = "a lost connection" if close is None else f"close {close.code} {close.reason}"
        return ServiceError("stream", expected="an open connection", got=got, cure="Open the stream again.")
