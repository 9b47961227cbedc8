"""``python -m clients.vmc``: a sender of the Virtual Motion Capture protocol moves the person of the page.

It listens to OSC packets over UDP, and sends the page on this machine each newest pose over a WebSocket on loopback;
the service is not involved. A program of your own feeds ``drape.motion.vmc_messages.VmcPoses`` with ``osc_messages``.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import struct
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.typing import Origin

from clients.calls import DEFAULT_URL
from drape.errors import DrapeError, InputError
from drape.motion.vmc_messages import VmcPoses

PORT, PAGE_PORT = 39539, 39540  # the protocol's usual port, and where the page looks
MOST_BYTES = 16 * 1024  # limit of a packet
MOST_PACKETS = 5000  # limit a second: sixty bones in packets of their own, eighty times
MOST_MESSAGES = 512  # in a packet
DEEPEST = 4  # limit of bundles within each other
RATE_HZ = 60.0  # poses to a page a second
MOST_PAGES = 4
_BUNDLE = b"#bundle\0"


def osc_messages(packet: bytes) -> list[tuple[str, list[object]]]:
    """Returns the address and the values, str, float or int, of each message in an OSC 1.0 packet, in bundles or alone.

    Raises ``InputError`` for other bytes, values of other types, and a packet that is too large.
    """
    try:
        if len(packet) > MOST_BYTES:
            raise ValueError(f"{len(packet)} bytes")
        messages = list(_messages(packet, DEEPEST))
        if len(messages) > MOST_MESSAGES:
            raise ValueError(f"{len(messages)} messages")
    except (ValueError, struct.error) as error:  # UnicodeDecodeError too
        cure = "Send VMC's own messages."
        expected = f"an OSC packet of at most {MOST_BYTES} bytes and {MOST_MESSAGES} messages"
        raise InputError("packet", expected=expected, got=str(error)[:80], cure=cure) from error
    return messages


def _messages(packet: bytes, depth: int) -> Iterator[tuple[str, list[object]]]:
    if not packet.startswith(_BUNDLE):
        yield _message(packet)
        return
    at = len(_BUNDLE) + 8  # a time of 8 bytes follows the name
    while at < len(packet):
        (size,) = struct.unpack_from(">i", packet, at)
        if not 0 < size <= len(packet) - at - 4 or depth == 0:
            raise ValueError(f"a part of {size} bytes in bundles {DEEPEST - depth + 1} deep")
        yield from _messages(packet[at + 4 : at + 4 + size], depth - 1)
        at += 4 + size


def _message(packet: bytes) -> tuple[str, list[object]]:
    address, at = _text(packet, 0)
    if not address.startswith("/"):
        raise ValueError(f"the address {address[:20]!r}")
    kinds, at = _text(packet, at)
    values: list[object] = []
    for kind in kinds[1:]:
        if kind == "s":
            value, at = _text(packet, at)
        elif kind in "if":
            (value,) = struct.unpack_from(f">{kind}", packet, at)
            at += 4
        else:
            raise ValueError(f"a value of type {kind!r}")
        values.append(value)
    return address, values


def _text(packet: bytes, at: int) -> tuple[str, int]:
    """The text that begins at ``at``, and where what follows begins: text is filled up to four bytes with zeros."""
    end = packet.index(0, at)
    return packet[at:end].decode(), end + 4 - (end - at) % 4


class Receiver(asyncio.DatagramProtocol):
    """Receives OSC packets over UDP and puts their messages into ``poses``, at most ``MOST_PACKETS`` packets a second;
    ``refused`` counts the others, and those that cannot be read."""

    def __init__(self) -> None:
        self.poses, self.refused = VmcPoses(), 0
        self._second, self._packets = 0, 0

    def datagram_received(self, data: bytes, addr: Any) -> None:
        second = int(time.monotonic())
        self._packets = self._packets + 1 if second == self._second else 1
        self._second = second
        if self._packets > MOST_PACKETS:
            self.refused += 1
            return
        try:
            for address, values in osc_messages(data):
                self.poses.take(address, values)
        except DrapeError:
            self.refused += 1


async def send_poses(connection: ServerConnection, poses: VmcPoses) -> None:
    """Sends a page each newest pose until it leaves, as JSON: "poses", 72 numbers of rotation vectors [rad], and
    "pelvis", three numbers, the place of the pelvis in lengths of the leg."""
    last = -1
    with suppress(ConnectionClosed):
        while True:
            newest = poses.pose() if poses.count != last else None
            last = poses.count
            if newest is not None:
                pose, pelvis = newest
                document = {"poses": pose.reshape(-1).round(5).tolist(), "pelvis": pelvis.round(5).tolist()}
                await connection.send(json.dumps(document))
            elif connection.close_code is not None:
                return
            await asyncio.sleep(1.0 / RATE_HZ)


def origins_of(page: str) -> list[Origin]:
    """Returns the HTTP origins of the page at the address ``page``: two for this machine, which has two names."""
    scheme, place = urlsplit(page)[:2]
    names = {place, place.replace("127.0.0.1", "localhost"), place.replace("localhost", "127.0.0.1")}
    return [Origin(f"{scheme}://{name}") for name in sorted(names)]


async def bridge(host: str, port: int, page_port: int, page: str) -> None:
    """Listens for VMC packets on ``host`` and ``port`` (UDP), and serves a WebSocket on ``page_port`` of this machine
    that sends the page at the address ``page`` each newest pose (``send_poses``).

    It runs until it is cancelled and prints both ports. Raises ``InputError`` where a port is taken.
    """
    loop, pages = asyncio.get_running_loop(), set[ServerConnection]()

    async def come(connection: ServerConnection) -> None:
        if sum(page.close_code is None for page in pages) >= MOST_PAGES:  # a page that left counts until its next pose
            return
        pages.add(connection)
        try:
            await send_poses(connection, receiver.poses)
        finally:
            pages.discard(connection)

    try:
        transport, receiver = await loop.create_datagram_endpoint(Receiver, local_addr=(host, port))
        try:
            async with serve(come, "127.0.0.1", page_port, origins=origins_of(page), max_size=1024) as server:
                ports = transport.get_extra_info("sockname")[1], next(iter(server.sockets)).getsockname()[1]
                print(f"VMC on {host} port {ports[0]}, for {page} on port {ports[1]}", flush=True)
                await asyncio.Future()
        finally:
            transport.close()
    except OSError as error:
        cure = "Close what has it, or choose another: --port, --page-port."
        raise InputError("port", expected="a free one", got=str(error.strerror), cure=cure) from error


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m clients.vmc", description="Moves the person of the page by VMC.")
    parser.add_argument("--host", default="127.0.0.1", help="where it listens; 0.0.0.0 for senders on other machines")
    parser.add_argument("--port", type=int, default=PORT, help=f"of the sender's packets ({PORT})")
    parser.add_argument("--page-port", type=int, default=PAGE_PORT, help=f"where the page looks ({PAGE_PORT})")
    parser.add_argument("--page", default=DEFAULT_URL, help=f"the address of the page ({DEFAULT_URL})")
    options = parser.parse_args(arguments)
    try:
        asyncio.run(bridge(options.host, options.port, options.page_port, options.page))
    except DrapeError as error:
        print(f"drape: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
