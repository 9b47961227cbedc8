"""The Python client of the stream: poses in, frames out, each with its age.

    async with await DrapeStream.open("http://127.0.0.1:8000", "tshirt") as stream:  # or ["trousers", "tshirt"]
        await stream.send(pose, trans)
        received = await stream.receive()
        received.frame.vertices(), received.age_s

    async with await DrapeStream.open(url, "tshirt", geometry="jets") as stream:
        await stream.send(pose, trans)
        layout.vertices((await stream.receive_jets()).frame)  # layout: DrapeClient.jet_layout("tshirt")

    async with await DrapeStream.open(url, "tshirt", avatar="me") as stream:
        await stream.send_rig(quaternions, place)  # of the character's own nodes

Frames answer the newest pose; poses that a newer one replaced are counted in ``frame.dropped``. A service that ends
hands the stream over to its successor, with what the cloth remembers: frames go on, and poses that it had not answered
are sent again. A body that stands still sends few poses: once the service has said that a pose changes nothing, the
client itself answers the same pose with the frame that is shown.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeVar

import numpy as np
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidProxy, InvalidURI
from websockets.typing import Subprotocol

from clients.calls import DEFAULT_URL, Size, key_headers, worn_fields
from clients.connections import stream_proxy, unreachable
from clients.refusals import ServiceError, problem_error
from drape.errors import DrapeError, Unavailable
from drape.wire import messages as wire
from drape.wire.jets import JetFrame, unpack_jets
from drape.wire.options import options_document
from drape.wire.rig_pose_message import RigPose, pack_rig_pose

MESSAGE_LIMIT_BYTES = 16 * 2**20
OPEN_S = 10.0
MOVE_S = 15.0  # another process must take the stream within it
RETRY_S = 0.2
HELD_S = 0.2  # poses are answered here for so long; a service takes a pause of 0.25 s for the end of a motion
CLOSEST_S = 1.0 / 240.0  # poses that follow each other faster are not answered here
GOING_AWAY = 1012  # the close code of a service that ends

Shown = TypeVar("Shown", wire.Frame, JetFrame)


@dataclass(frozen=True, eq=False)
class Received:
    """A frame, and the time [s] from the sending of its pose to its arrival, by this machine's clock."""

    frame: wire.Frame
    age_s: float


@dataclass(frozen=True, eq=False)
class ReceivedJets:
    """A frame of posed patches, and the time [s] from the sending of its pose to its arrival, by this machine's
    clock."""

    frame: JetFrame
    age_s: float


class DrapeStream:
    """An open stream of a garment or an outfit.

    ``about`` is the JSON with which the service answered the latest opening ("opened" in docs/reference/wire.md),
    ``url`` the address of the service, and ``moves`` the number of times that another process took the stream over.
    """

    def __init__(
        self, connection: ClientConnection, url: str, key: str | None, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self._connection, self._key, self._clock = connection, key, clock
        self._sequence = 0
        self._request: dict[str, Any] = {}
        self._unanswered: dict[int, bytes] = {}  # poses, as sent
        self._still: bytes | None = None  # the pose that changes nothing
        self._sent_s, self._asked_s = -HELD_S, 0.0  # when a pose was last sent, and given to ``send``
        self._held: deque[tuple[int, float]] = deque()  # numbers and times of poses that are answered here
        self._more = asyncio.Event()  # set when there are some in ``_held``
        self._reading: asyncio.Future[str | bytes] | None = None
        self._state: list[bytes] = []
        self._shown: wire.Frame | JetFrame | None = None
        self._sending = asyncio.Lock()
        self.url, self.moves, self.about = url, 0, {}

    @classmethod
    async def open(
        cls,
        url: str = DEFAULT_URL,
        garment: str | Sequence[str] = "",
        *,
        betas: Sequence[float] | np.ndarray | None = None,
        avatar: str | None = None,
        size: Size = None,
        key: str | None = None,
        clock: Callable[[], float] = time.perf_counter,
        **options: Any,
    ) -> DrapeStream:
        """Returns an open stream of ``garment``, or of several, from the service at ``url``; raises the service's
        refusal.

        ``options`` are the fields of ``drape.wire.options.DrapeOptions``. ``betas``: the body's shape. ``avatar``: the
        id of the character that wears the garments. ``size``: one for all garments, or a list with one for each.
        ``key``: an API key or a ticket, where the service has keys. ``clock`` returns the time [s] of the motion, with
        which poses are stamped and ages taken.
        """
        stream = cls(await _connected(url, key), url, key, clock)
        try:
            await stream.reopen(garment, betas=betas, avatar=avatar, size=size, **options)
        except BaseException:
            await stream.close()
            raise
        return stream

    async def __aenter__(self) -> DrapeStream:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Ends the stream."""
        await self._connection.close()
        if self._reading is not None:
            await asyncio.gather(self._reading, return_exceptions=True)

    async def reopen(
        self,
        garment: str | Sequence[str],
        *,
        betas: Sequence[float] | np.ndarray | None = None,
        avatar: str | None = None,
        alive: bool = False,
        size: Size = None,
        **options: Any,
    ) -> dict[str, Any]:
        """Opens the stream anew for other garments, shape, ``avatar``, ``size`` or ``options``, and returns the
        service's answer (``about``); older frames are thrown away. The arguments are those of ``open``.

        Several garments are worn over each other, the innermost first; ``layers`` splits their vertices. With geometry
        jets, frames come from ``receive_jets``. Raises the service's refusal.
        """
        shape = None if betas is None else [float(beta) for beta in betas]
        about = {"betas": shape, "moves": True, "same": True, **options_document(options)}
        self._request = {
            "type": "open",
            **worn_fields(garment, {"avatar": avatar, "alive": alive, "size": size}),
            **about,
        }
        self._unanswered.clear()
        self._held.clear()
        self._still = None
        await self._transmit(json.dumps(self._request))
        while True:
            message = await self._message()
            if isinstance(message, str):
                self.about = json.loads(message)
                return self.about

    def layers(self, vertices: np.ndarray) -> list[np.ndarray]:
        """Returns the ``vertices`` (V, 3) of a frame split into those of each garment, the innermost first."""
        counts = [layer["vertices"] for layer in self.about.get("garments", ())]
        return np.split(vertices, np.cumsum(counts, dtype=int)[:-1])

    async def send(self, pose: np.ndarray, trans: np.ndarray | None = None) -> int:
        """Sends a pose (24, 3) [rad] with its root translation (3,) [m], zero if left out; returns its sequence
        number."""
        place = np.zeros(3) if trans is None else np.asarray(trans)
        return await self._sent(
            lambda sequence, now_s: wire.pack_pose(wire.Pose(sequence, now_s, place, np.asarray(pose)))
        )

    async def send_rig(self, quaternions: np.ndarray, place: np.ndarray | None = None) -> int:
        """Sends a pose of the avatar's own rig and returns its sequence number: the local quaternions (N, 4), x, y, z,
        w, of its nodes, and the ``place`` (3,) [m] of the pelvis's node, None for its rest place.

        Raises ``Unavailable`` where no avatar wears the garments, or the service is too old to take such poses.
        """
        if "nodes" not in self.about:
            cure = "Open with an avatar, at a service of this release, or send poses of ours."
            raise Unavailable("send_rig", expected="a stream that takes poses of a rig", got="another", cure=cure)
        return await self._sent(lambda sequence, now_s: pack_rig_pose(RigPose(sequence, now_s, place, quaternions)))

    async def _sent(self, packed: Callable[[int, float], bytes]) -> int:
        """Sends the pose that ``packed`` makes a message of, with its sequence number and time; returns the number."""
        self._sequence = sequence = (self._sequence + 1) & 0xFFFFFFFF
        now_s = self._clock()
        message = packed(sequence, now_s)
        before_s, self._asked_s = self._asked_s, now_s
        # The next pose, as much later as this one was after the one before, must not come too late either.
        if wire.pose_content(message) == self._still and CLOSEST_S < now_s - before_s < self._sent_s + HELD_S - now_s:
            self._held.append((sequence, now_s))
            self._more.set()
            return sequence
        self._sent_s, self._still = now_s, None
        self._unanswered[sequence] = message
        while len(self._unanswered) > self.about["credit"]:
            del self._unanswered[next(iter(self._unanswered))]
        await self._transmit(message)
        return sequence

    async def receive(self) -> Received:
        """Waits for the next frame of a stream of vertices, acknowledges it, and returns it with its age.

        Raises the service's refusal, and ``ServiceError`` where the connection ends.
        """
        frame = await self._next(wire.Frame, wire.unpack_frame)
        return Received(frame, self._clock() - frame.client_time_s)

    async def receive_jets(self) -> ReceivedJets:
        """Waits for the next frame of a stream of jets, acknowledges it, and returns it with its age.

        ``frame.layers`` splits it into garments. Raises what ``receive`` does.
        """
        frame = await self._next(JetFrame, unpack_jets)
        return ReceivedJets(frame, self._clock() - frame.client_time_s)

    async def _next(self, kind: type[Shown], unpack: Callable[[bytes], Shown]) -> Shown:
        """The next frame: one that came, acknowledged; or for a body that stands still the last one once more."""
        message = await self._binary()
        if message is None:
            assert isinstance(self._shown, kind)
            sequence, sent_s = self._held.popleft()
            self._shown = frame = replace(self._shown, sequence=sequence, client_time_s=sent_s, residence_us=0)
        elif wire.message_kind(message) == wire.SAME and isinstance(self._shown, kind):
            self._shown = frame = replace(self._shown, **asdict(wire.unpack_same(message)))
            if frame.sequence == self._sequence and frame.sequence in self._unanswered:
                self._still = wire.pose_content(self._unanswered[frame.sequence])
            self._answered(frame.sequence)
        else:
            self._shown = frame = unpack(message)
            self._answered(frame.sequence)
            await self._transmit(wire.pack_ack(frame.sequence))
        return frame

    def _answered(self, sequence: int) -> None:
        """Forgets the poses up to that of ``sequence``, which need no answer any more."""
        if sequence in self._unanswered:
            while next(iter(self._unanswered)) != sequence:
                del self._unanswered[next(iter(self._unanswered))]
            del self._unanswered[sequence]

    async def _binary(self) -> bytes | None:
        """The next frame's message; None if a pose of ``_held`` is answered first."""
        while not self._held:
            self._more.clear()
            waiting = asyncio.ensure_future(self._more.wait())
            try:
                await asyncio.wait((self._read(), waiting), return_when=asyncio.FIRST_COMPLETED)
            finally:
                waiting.cancel()
            if self._held:
                break
            message = await self._message()
            if isinstance(message, bytes):
                return message
        return None

    async def _transmit(self, message: str | bytes) -> None:
        """Sends ``message``. If the service is ending, the message is dropped, and ``_message`` handles the end."""
        async with self._sending:
            try:
                await self._connection.send(message)
            except ConnectionClosed as error:
                if error.rcvd is None or error.rcvd.code != GOING_AWAY:
                    raise await self._reason(error) from error

    async def _message(self) -> str | bytes:
        """The next message. After a hand-over it is the successor's answer to the opening."""
        while True:
            try:
                message = await asyncio.shield(self._read())
            except ConnectionClosed as error:
                self._reading = None
                raise await self._reason(error) from error
            self._reading = None
            if isinstance(message, bytes):
                if wire.message_kind(message) != wire.STATE:
                    return message
                self._state.append(message)
                continue
            document = json.loads(message)
            if document.get("type") == "error":
                raise problem_error(document)
            if document.get("type") == "moved":
                return await self._move(document)
            return message

    def _read(self) -> asyncio.Future[str | bytes]:
        """The next message. A caller that stops waiting leaves it to the next one."""
        if self._reading is None:
            self._reading = asyncio.ensure_future(self._connection.recv())
            self._reading.add_done_callback(_seen)
        return self._reading

    async def _move(self, document: dict[str, Any]) -> str:
        """Connects to the process that ``document`` names and sends it the state; returns its answer to the opening."""
        url = document["to"] or self.url
        # The ticket that opened this stream is spent; a key is as good there.
        key = document.get("ticket", self._key) if self._key and "." in self._key else self._key
        async with self._sending:
            await self._connection.close()
            state, self._state = self._state, []
            self._connection = await _connected_soon(url, key)
            self.url, self._key, self.moves = url, key, self.moves + 1
            try:
                for message in (*state, json.dumps(self._request)):
                    await self._connection.send(message)
                answer = await self._connection.recv()
                for message in list(self._unanswered.values()):
                    await self._connection.send(message)
            except ConnectionClosed as error:
                raise await self._reason(error) from error
        document = json.loads(answer)
        if document.get("type") == "error":
            raise problem_error(document)
        self.about = document
        return str(answer)

    async def _reason(self, error: ConnectionClosed) -> DrapeError:
        """The service's sentence if one came before the close, else the close code."""
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


def _seen(reading: asyncio.Future[str | bytes]) -> None:
    """Takes the error of a stream that nobody reads any more, which asyncio would report."""
    if not reading.cancelled():
        reading.exception()


async def _connected(url: str, key: str | None) -> ClientConnection:
    """A connection to the stream of the service at ``url``; raises ``Unavailable`` where none can be had."""
    address = url.rstrip("/").replace("http", "ws", 1) + "/stream"
    try:
        return await connect(
            address,
            subprotocols=[Subprotocol(wire.SUBPROTOCOL)],
            additional_headers=key_headers(key),
            compression=None,
            max_size=MESSAGE_LIMIT_BYTES,
            open_timeout=OPEN_S,
            proxy=stream_proxy(url),
        )
    except (OSError, TimeoutError, InvalidHandshake, InvalidURI, InvalidProxy, ImportError) as error:
        raise unreachable(address, error) from error


async def _connected_soon(url: str, key: str | None) -> ClientConnection:
    """``_connected``, tried for ``MOVE_S``: the process that takes over may still load."""
    until_s = time.monotonic() + MOVE_S
    while True:
        try:
            return await _connected(url, key)
        except Unavailable:
            if time.monotonic() > until_s:
                raise
        await asyncio.sleep(RETRY_S)
